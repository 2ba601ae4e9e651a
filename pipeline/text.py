"""Text from elsewhere, with invisible characters shown as escapes."""

import re
from collections.abc import Callable

# Unicode's Default_Ignorable_Code_Point as far as ``str.isprintable`` lets it pass, and the blank
# of braille
_BLANK = re.compile(
    "[\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180d\u180f\u2800\u3164\ufe00-\ufe0f\uffa0"
    "\U000e0100-\U000e01ef]"
)


def _escape(character: str) -> str:
    r"""As in Python's strings: ``\x1b``, ``\u202e``, ``\n``."""
    return character.encode("unicode_escape").decode()


def visible(text: str, escape: Callable[[str], str] = _escape) -> str:
    """A text on one line, with control, invisible and bidirectional characters as escapes."""
    hidden = {ord(c): escape(c) for c in set(text) if not c.isprintable() or _BLANK.match(c)}
    return text.translate(hidden) if hidden else text
