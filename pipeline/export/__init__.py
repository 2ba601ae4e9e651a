"""Plans as files that other tools read: tables, orbit data messages, a script for a simulator."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pipeline.errors import InputError, check_choice
from pipeline.export.basilisk import write_basilisk
from pipeline.export.burns import Masses, PerCraft, write_burns
from pipeline.export.messages import write_ephemerides, write_parameters
from pipeline.export.tables import write_csv, write_parquet
from pipeline.plan import Plan

__all__ = ["FORMATS", "Format", "write_plan_as"]


@dataclass(frozen=True)
class Format:
    """An export format of plans: one file for all craft, or a folder with a file for each."""

    write: Callable[..., list[Path] | None]  # its files, where it writes a folder
    suffix: str = ""  # of the file; a folder has none, and its files have the plan's name in them
    text: bool = True
    masses: tuple[str, ...] = ()  # that it has a place for: mass, specific_impulse


FORMATS = {
    "oem": Format(write_ephemerides),
    "opm": Format(write_parameters, masses=("mass", "specific_impulse")),
    "csv": Format(write_csv, ".csv"),
    "parquet": Format(write_parquet, ".parquet", text=False),
    "burns": Format(write_burns, ".burns.csv", masses=("mass", "specific_impulse")),
    "basilisk": Format(write_basilisk, ".basilisk.py", masses=("mass",)),
}


def write_plan_as(
    to: str,
    plan: Plan,
    path: Path,
    name: str,
    *,
    mass: PerCraft | None = None,
    specific_impulse: PerCraft | None = None,
) -> list[Path]:
    """Write a plan in one of FORMATS, and return the files.

    Messages name their objects by ``name``. Masses of craft at the first node, in kg, and specific
    impulses of their thrusters, in s, are one number for all craft or one for each; by default the
    scenario's masses.

    Raises:
        InputError: for masses that the format has no place for, or a plan that cannot be written.
    """
    check_choice("to", to, FORMATS)
    form = FORMATS[to]
    for known, value in (("mass", mass), ("specific_impulse", specific_impulse)):
        if value is not None and known not in form.masses:
            raise InputError(f"{known} is given, and {to} has no place for it; leave it out.")
    own = [one.mass for one in plan.scenario.craft if one.mass is not None]
    if mass is None and len(own) == plan.scenario.n:
        mass = own
    masses = Masses.of(plan.scenario.n, mass, specific_impulse)
    names = [] if form.suffix else [name]
    return form.write(plan, path, *names, *[masses] * bool(form.masses)) or [path]
