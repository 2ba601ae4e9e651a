"""Parts of experiments that are under way, beside the tracking store until a run has them."""

import hashlib
import json
import platform
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

from pipeline.experiments.parts import Kept, kept_in
from pipeline.progress import SILENT, Progress
from pipeline.provenance import made_with
from pipeline.storage.folder import open_folder
from registry.environment import EVALUATED_BY
from registry.store import connect

PLACE = "mlruns/.unfinished"
DIGITS = 32  # hexadecimal digits of what decides the parts, in the name of their folder


@contextmanager
def unfinished(
    experiment: str, decided_by: Mapping[str, Any], *, resume: bool, progress: Progress = SILENT
) -> Iterator[Kept]:
    """The finished parts of an experiment, which are removed once the block has ended well.

    With ``resume`` those of an earlier run that did not end are there, where what decides them was
    the same, as were the versions and the machine, whose times they have; else they are removed.
    InputError where another process is doing the same.
    """
    settings = {
        **decided_by,
        "made_with": dict(made_with(*EVALUATED_BY)),
        "machine": platform.node(),
    }
    text = json.dumps(settings, sort_keys=True, default=str).encode()
    name = f"{experiment}-{hashlib.sha256(text).hexdigest()[:DIGITS]}"
    place = connect().beside / PLACE
    with kept_in(open_folder(place / name), EVALUATED_BY, again=resume, progress=progress) as kept:
        yield kept
    shutil.rmtree(place / name, ignore_errors=True)
    with suppress(OSError):  # where other experiments are under way
        place.rmdir()
