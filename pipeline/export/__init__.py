"""Plans as files that other tools read: tables, orbit data messages, a script for a simulator."""

from dataclasses import dataclass
from pathlib import Path

from pipeline.errors import InputError, check_choice
from pipeline.export.basilisk import write_basilisk
from pipeline.export.messages import write_ephemerides, write_orbit_parameters
from pipeline.export.tables import Masses, NumberOrEach, write_burns, write_csv, write_parquet
from pipeline.plan.plan import Plan


@dataclass(frozen=True)
class Format:
    """An export format of plans: one file for all craft, or a folder with a file for each."""

    suffix: str = ""  # of the file; a folder has none
    text: bool = True
    masses: tuple[str, ...] = ()  # that it has a place for: mass, specific_impulse


FORMATS = {
    "oem": Format(),
    "opm": Format(masses=("mass", "specific_impulse")),
    "csv": Format(".csv"),
    "parquet": Format(".parquet", text=False),
    "burns": Format(".burns.csv", masses=("mass", "specific_impulse")),
    "basilisk": Format(".basilisk.py", masses=("mass",)),
}


def write_plan_as(
    to: str,
    plan: Plan,
    path: Path,
    name: str,
    *,
    mass: NumberOrEach | None = None,
    specific_impulse: NumberOrEach | None = None,
) -> list[Path]:
    """Write a plan in one of FORMATS, and return the files.

    Messages name their objects by ``name``. Masses of craft at the first node, in kg, and specific
    impulses of their thrusters, in s, are one number for all craft or one for each; by default the
    scenario's masses, of the craft that have one. InputError for masses that the format has no
    place for, or a plan that cannot be written.
    """
    check_choice("to", to, FORMATS)
    for known, value in (("mass", mass), ("specific_impulse", specific_impulse)):
        if value is not None and known not in FORMATS[to].masses:
            raise InputError(f"{known} is given, and {to} has no place for it; leave it out.")
    own = [one.mass for one in plan.scenario.craft]
    given = own if mass is None and any(own) else mass
    masses = Masses.of(plan.scenario.n, given, specific_impulse)
    match to:
        case "oem":
            return write_ephemerides(plan, path, name)
        case "opm":
            return write_orbit_parameters(plan, path, name, masses)
        case "burns":
            write_burns(plan, path, masses)
        case "basilisk":
            write_basilisk(plan, path, masses)
        case "csv":
            write_csv(plan, path)
        case _:
            write_parquet(plan, path)
    return [path]
