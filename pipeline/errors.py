"""Errors for the person who can act on them: what was given, what is expected, what to do."""


class ProlearnError(Exception):
    """A run that failed for a reason outside the input; the command line exits with 1."""


class InputError(ProlearnError):
    """Input that cannot be worked with, in one sentence; the command line exits with 2."""
