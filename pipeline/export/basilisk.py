"""A plan as a Python script that flies it in Basilisk, an independent simulator."""

from math import ceil, exp
from pathlib import Path

import numpy as np

from pipeline.export.inertial import reference_frames, stamp
from pipeline.export.tables import Masses, burns_of
from pipeline.files import STDIO, write_text
from pipeline.markup import template
from pipeline.orbit.forces import EARTH_RATE
from pipeline.orbit.reference import J2, MU_EARTH, R_EARTH
from pipeline.plan.plan import Plan
from pipeline.text import visible

TURN = 0.002  # largest angle by which the reference turns in a step, rad


def write_basilisk(plan: Plan, path: Path, masses: Masses) -> None:
    """Write the script, which needs Basilisk (PyPI: bsk) and numpy alone; it appears whole.

    Craft and a chief, the reference orbit, start at the first node about the Earth of the plan's
    world; burns are held along the chief's LVLH axes. Of a plan about a circle, the world is that
    of ephemerides: two bodies. InputError where the scenario does not say where its orbit is, or
    for states that are not what the controls lead to.
    """
    scenario, burns = plan.scenario, burns_of(plan, masses)
    problem, orbit, n = scenario.problem, scenario.problem.orbit, scenario.n
    origin, frame = reference_frames(scenario, np.zeros(n))
    turn = problem.dynamics.fastest * problem.time_step
    table = np.column_stack([burns.craft, burns.interval]).tolist()
    names = [ascii(visible(one.name) or f"craft-{k}") for k, one in enumerate(scenario.craft)]
    drag = None
    if orbit is not None and orbit.ballistic is not None:
        air = orbit.air
        ballistics = orbit.ballistic, orbit.ballistics(n).tolist()
        drag = *ballistics, air.density * exp(air.base / air.scale), air.scale
    apart = ", kept apart at the nodes only" * (plan.separation == "nodes")
    text = template("pipeline/export/basilisk.py.jinja").render(
        # As literals: what a name from a file has in it is never code.
        planned=ascii(f"{n} craft by {visible(plan.planner)}: {plan.status}{apart}"),
        nodes=ascii("nodes.csv" if path == STDIO else f"{path.stem}.nodes.csv"),
        epoch=ascii(scenario.reference and stamp(scenario.reference.epoch)),
        mu=MU_EARTH,
        radius=R_EARTH,
        j2=J2 if orbit is not None and orbit.j2 else 0.0,
        intervals=problem.intervals,
        time_step=float(problem.time_step),
        steps=max(1, ceil(turn / TURN)),
        chief=origin[0].tolist(),
        initial=(origin + frame.to_inertial(scenario.initial)).tolist(),
        goals=scenario.goal[:, :3].tolist(),
        names=f"[{', '.join(names)}]" * any(one.name for one in scenario.craft),
        masses=np.nan_to_num(masses.mass, nan=1.0).tolist(),
        burns=[(*at, *u) for at, u in zip(table, burns.acceleration.tolist(), strict=True)],
        drag=drag,
        earth_rate=EARTH_RATE,
    )
    write_text(path, text)
