"""Runs, models and results in MLflow, which no other package imports; ProlearnError if it fails."""

import getpass
import os
from pathlib import Path

from pipeline.errors import InputError

try:
    Path.home()
except RuntimeError as error:  # as MLflow ends when it is imported
    raise InputError("there is no home folder; expected HOME to name one: set it.") from error
try:
    getpass.getuser()
except (KeyError, OSError):  # a number without a name, as in a container; MLflow would complain
    os.environ["LOGNAME"] = str(os.getuid())
