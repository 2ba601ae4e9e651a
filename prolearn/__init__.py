"""Transfer planning for spacecraft swarms from Python: all that a program or a notebook needs.

    import prolearn
    from prolearn import Ring

    swarm = prolearn.scenario(
        initial=[Ring(craft=3, size=150, tilt_deg=20), Ring(craft=3, size=100, tilt_deg=-20)],
        goal=[Ring(craft=3, size=100, tilt_deg=-20), Ring(craft=3, size=150, tilt_deg=20)],
        altitude=500e3,
    )
    plan = prolearn.plan(swarm)
    print(plan.status, plan.certificate.delta_v, plan.certificate.min_separation)

Arrays are numpy's; units are m, s, m/s and m/s², states are x y z vx vy vz in the LVLH frame. What
this package names is kept from version to version; ``pipeline``, ``registry`` and ``cli``, where
it is made, may change. Bad input raises ``InputError``, a sentence with what was given, what is
expected and what to do. What a light installation leaves out is imported when it is asked for, and
an ``InputError`` says which extra has it.
"""

from cli.jobs.planner import planner_of as planner
from pipeline.errors import InputError, ProlearnError
from pipeline.expert import Settings
from pipeline.flight.effects import Effect
from pipeline.flight.errors import COLD_GAS, Errors
from pipeline.flight.summary import Summary
from pipeline.flight.world import Conditions
from pipeline.orbit.corridors import Box, Cone, Corridor
from pipeline.orbit.participants import Obstacle
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import Reference
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.thrust import Thrust
from pipeline.plan.certificate import Certificate
from pipeline.plan.document import read_plan, write_plan
from pipeline.plan.plan import Plan
from pipeline.plan.requirements import Requirements, RiskLimit
from pipeline.planners.planner import Planner
from pipeline.scenario import FAMILIES, Diagnostic, Scenario, draw
from pipeline.scenario import diagnostics as check
from pipeline.scenario.document import read_scenario, write_scenario
from pipeline.scenario.spacecraft import Spacecraft
from pipeline.scenario.waypoint import Waypoint
from pipeline.tradeoff import Point
from prolearn.learned import load_model, models, read_dataset
from prolearn.planning import MonteCarlo, fly, monte_carlo, plan, plan_all, tradeoff
from prolearn.swarms import Ring, scenario, scenario_from_files
from prolearn.views import Page, Plot, convert, plot, show

__all__ = [
    "COLD_GAS",
    "FAMILIES",
    "Box",
    "Certificate",
    "Conditions",
    "Cone",
    "Corridor",
    "Diagnostic",
    "Effect",
    "Errors",
    "InputError",
    "MonteCarlo",
    "Obstacle",
    "Page",
    "Plan",
    "Planner",
    "Plot",
    "Point",
    "Problem",
    "ProlearnError",
    "Reference",
    "ReferenceOrbit",
    "Requirements",
    "Ring",
    "RiskLimit",
    "Scenario",
    "Settings",
    "Spacecraft",
    "Summary",
    "Thrust",
    "Waypoint",
    "check",
    "convert",
    "draw",
    "fly",
    "load_model",
    "models",
    "monte_carlo",
    "plan",
    "plan_all",
    "planner",
    "plot",
    "read_dataset",
    "read_plan",
    "read_scenario",
    "scenario",
    "scenario_from_files",
    "show",
    "tradeoff",
    "write_plan",
    "write_scenario",
]
