"""A plan as tables: its states and controls at the nodes, and its burns."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from reprlib import repr as brief

import numpy as np

from pipeline.arrays import Array, Float, as_lists
from pipeline.errors import InputError, is_number
from pipeline.export.inertial import reference_frames, stamp
from pipeline.files import published, write_rows
from pipeline.orbit.thrust_cost import allocated_thrusts, cost_within
from pipeline.plan.document import plan_document
from pipeline.plan.judge import check_states
from pipeline.plan.plan import Plan

METADATA_KEY = b"prolearn"
STATE, CONTROL = ("x", "y", "z", "vx", "vy", "vz"), ("ux", "uy", "uz")
BESIDE = ("times", "states", "controls")  # columns of a table; other fields are metadata
GRAVITY = 9.80665  # standard acceleration of free fall, by which specific impulse is defined, m/s²
LEAST, MOST = 1e-12, 1e6  # of masses, kg, as in scenarios, and of specific impulses, s

NumberOrEach = float | Sequence[float | None]


def columns_of(plan: Plan) -> dict[str, Array]:
    """Craft, node, time_s, state (m, m/s, LVLH) and the control (m/s²) that begins at the node.

    At the last node no control begins: it is NaN there. InputError where the states are not what
    the controls lead to.
    """
    check_states(plan)
    n, T = plan.states.shape[:2]
    node = np.tile(np.arange(T, dtype=np.int32), n)
    craft = np.repeat(np.arange(n, dtype=np.int32), T)
    columns = {"craft": craft, "node": node, "time_s": node * plan.scenario.problem.time_step}
    held = np.concatenate([plan.controls, np.full((n, 1, 3), np.nan)], axis=1)
    for names, values in ((STATE, plan.states), (CONTROL, held)):
        columns |= dict(zip(names, values.reshape(n * T, -1).T, strict=True))
    return columns


def write_csv(plan: Plan, path: Path) -> None:
    """Write the table as CSV, with a header line; the file appears whole, or on stdout."""
    columns = columns_of(plan)
    write_rows(path, columns, zip(*(values.tolist() for values in columns.values()), strict=True))


def write_parquet(plan: Plan, path: Path) -> None:
    """Write the table as Parquet, with page checksums; the file appears whole.

    What is NaN is null. The schema's metadata has a key ``prolearn``: the plan file's JSON without
    its arrays, certificate and scenario included.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = {
        name: pa.array(values, from_pandas=True) for name, values in columns_of(plan).items()
    }
    rest = {k: v for k, v in plan_document(plan).items() if k not in BESIDE}
    table = pa.table(columns, metadata={METADATA_KEY: json.dumps(rest).encode()})
    # Arrow opens only files whose names are UTF-8.
    with published(path) as temporary, temporary.open("wb") as file:
        pq.write_table(table, file, write_page_checksum=True)


@dataclass(frozen=True, eq=False)
class Masses:
    """Masses of craft, and the specific impulses of their thrusters; NaN where not known."""

    mass: Float[Array, "n"]  # at the first node, kg
    specific_impulse: Float[Array, "n"]  # s; without it no propellant is counted

    @classmethod
    def of(
        cls, n: int, mass: NumberOrEach | None = None, specific_impulse: NumberOrEach | None = None
    ) -> "Masses":
        """Masses, kg, and specific impulses, s, of n craft.

        Each is one number for all craft, or one for each, None where it is not known. InputError
        for other counts, numbers out of range, or specific impulses without masses.
        """
        if mass is None and specific_impulse is not None:
            raise InputError("specific_impulse is given without mass; expected both.")
        impulse = _per_craft("specific_impulse", specific_impulse, n)
        return cls(_per_craft("mass", mass, n), impulse)


def _per_craft(name: str, given: NumberOrEach | None, n: int) -> Float[Array, "n"]:
    values = np.atleast_1d(np.array(as_lists(given), dtype=object))
    fine = all(one is None or (is_number(one) and LEAST <= one <= MOST) for one in values.flat)
    if not fine or values.shape not in ((1,), (n,)):
        few = values.ravel()[:4].tolist()
        said = ", ".join(f"{one:g}" if is_number(one) else brief(one) for one in few)
        raise InputError(
            f"{name} is {said}{', ...' if values.size > 4 else ''}; expected a number "
            f"from {LEAST:g} to {MOST:g} for all craft, or one for each of {n}."
        )
    return np.broadcast_to(values.astype(float), n).copy()


@dataclass(frozen=True, eq=False)
class Burns:
    """Intervals in which craft thrust, in the order of craft and time; SI units, a row each.

    Propellant is taken for what controls cost by the scenario's kind of thrust, within its limits.
    """

    craft: Array
    interval: Array  # from 0; it begins at the node of this number
    acceleration: Float[Array, "burns 3"]  # held along LVLH axes, m/s²
    thrusts: Float[Array, "burns K"]  # of each thruster, m/s²; only of thrusters with directions
    delta_v: Float[Array, "burns"]  # by the scenario's kind of thrust, m/s
    mass: Float[Array, "burns"]  # before, kg; NaN where it is not known
    propellant: Float[Array, "burns"]  # that it takes, kg; NaN where it is not known


def burns_of(plan: Plan, masses: Masses) -> Burns:
    """The burns of a plan; InputError where its states are not what the controls lead to."""
    check_states(plan)
    problem, limits = plan.scenario.problem, plan.scenario.limits
    burned = cost_within(plan.controls, problem.thrust, limits)
    used = problem.time_step * burned
    fired = np.zeros((*used.shape, 0))
    if limits is not None and not isinstance(problem.thrust.model, str):
        fired = allocated_thrusts(plan.controls, limits, problem)
    craft, interval = np.nonzero(used)
    exhaust, before = GRAVITY * masses.specific_impulse[:, None], np.cumsum(used, axis=1) - used
    # Tsiolkovsky; a mass from which no propellant is counted stays.
    mass = masses.mass[:, None] * np.exp(-np.nan_to_num(before / exhaust))
    propellant = -mass * np.expm1(-used / exhaust)
    at = craft, interval
    return Burns(*at, plan.controls[at], fired[at], used[at], mass[at], propellant[at])


def write_burns(plan: Plan, path: Path, masses: Masses) -> None:
    """Write the list of burns as CSV, with a header line; the file appears whole, or on stdout.

    What is not known is empty: times in UTC without a ``reference``, inertial accelerations where
    the scenario does not say where its orbit is, masses.
    """
    scenario, burns = plan.scenario, burns_of(plan, masses)
    h, where = scenario.problem.time_step, scenario.reference
    start, size = burns.interval * h, np.linalg.norm(burns.acceleration, axis=1)
    inertial = np.full_like(burns.acceleration, np.nan)
    if len(start) and (where is not None or scenario.problem.orbit is not None):
        frame = reference_frames(scenario, start + h / 2)[1]
        inertial = np.matvec(frame.axes, burns.acceleration)
    columns = {
        "craft": burns.craft,
        "node": burns.interval,
        "time_s": start,
        "utc": [stamp(where.epoch, t) + "Z" if where else None for t in start.tolist()],
        "duration_s": np.full(len(start), h),
        **dict(zip(CONTROL, burns.acceleration.T, strict=True)),
        **{f"{name}_eme2000": u for name, u in zip(CONTROL, inertial.T, strict=True)},
        "delta_v": burns.delta_v,
        "delta_v_2norm": h * size,
        "mass": burns.mass,
        "force": burns.mass * size,
        "propellant": burns.propellant,
        **{f"thrust_{k}": each for k, each in enumerate(burns.thrusts.T)},
    }
    rows = (v.tolist() if isinstance(v, np.ndarray) else v for v in columns.values())
    write_rows(path, columns, zip(*rows, strict=True))
