"""Orbit data messages (CCSDS 502.0-B) in keyword = value notation: a folder with a file a craft."""

import re
from collections.abc import Callable, Iterable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from textwrap import wrap

from pipeline.files import write_text
from pipeline.orbit.reference import radius_at
from pipeline.plan import Plan
from pipeline.scenario.orbit_document import OrbitDocument
from pipeline.text import visible

LONGEST = 100  # characters of a comment on one line; messages have at most 254 on any
ORIGINATOR = "ORIGINATOR = PROLEARN"  # the line by which files of ours are known


def write_messages(
    folder: Path, suffix: str, n: int, message: Callable[[int], Iterable[str]]
) -> list[Path]:
    """Write the lines of a message for each of n craft, as ``craft-0`` and so on with a suffix.

    Files of craft that an earlier plan had there, and this one has not, are removed.
    """
    paths = [folder / f"{craft_name(k, n)}{suffix}" for k in range(n)]
    for k, path in enumerate(paths):
        write_text(path, "\n".join(message(k)) + "\n")
    for old in folder.glob(f"craft-*{suffix}"):
        if old not in paths and ORIGINATOR in old.read_text(encoding="utf-8", errors="replace"):
            old.unlink()
    return paths


def craft_name(craft: int, n: int) -> str:
    """Name of one of n craft, in as many digits as the last one has."""
    return f"craft-{craft:0{len(str(n - 1))}d}"


def header(version: str, plan: Plan, craft: int) -> Iterator[str]:
    """The first lines, from the one with the version: what the message is about, and whose."""
    problem = plan.scenario.problem
    planner = visible(plan.planner).encode("ascii", "replace").decode()
    about = f"Craft {craft} of {plan.scenario.n}, planned by {planner}: {plan.status}."
    about += " Craft are kept apart at the nodes only." * (plan.separation == "nodes")
    yield version
    yield from _comments(about)
    if problem.orbit is None:
        yield "COMMENT Relative motion is linear (Clohessy-Wiltshire). It was added to a circular"
        yield f"COMMENT two-body orbit of mean motion {problem.mean_motion!r} rad/s,"
        yield f"COMMENT radius {radius_at(problem.mean_motion) / 1e3:.9f} km."
    else:
        motion = "as flown in all terms" if plan.as_flown else "linear"
        yield f"COMMENT Relative motion is {motion}, about an orbit of osculating elements"
        named = OrbitDocument.of(problem.orbit).model_dump()
        yield from _comments(", ".join(f"{name} {value}" for name, value in named.items()) + ".")
    yield f"CREATION_DATE = {stamp(datetime.now(UTC))}"
    yield ORIGINATOR


def described(plan: Plan, craft: int, name: str) -> Iterator[str]:
    """The lines of metadata on a craft of a plan with a name, and on frame and time."""
    label = re.sub(r"[^A-Za-z0-9_.-]+", "-", name)
    whole = f"{label}-{craft_name(craft, plan.scenario.n)}"
    yield f"OBJECT_NAME = {whole}"
    yield f"OBJECT_ID = {whole}"
    yield "CENTER_NAME = EARTH"
    yield "REF_FRAME = EME2000"
    yield "TIME_SYSTEM = UTC"


def stamp(time: datetime, seconds: float = 0.0) -> str:
    """A time so many seconds later, in whole microseconds."""
    later = time + timedelta(microseconds=round(1e6 * seconds))
    return later.strftime("%Y-%m-%dT%H:%M:%S.%f")


def _comments(text: str) -> list[str]:
    return [f"COMMENT {line}" for line in wrap(text, LONGEST)]
