"""Whatever is asked of a plan together is kept by every planner, or refused in a sentence."""

from dataclasses import asdict, replace
from itertools import combinations

import numpy as np
import pytest
import torch
from judge import Case, closest_adrift, judge_plan
from judged import document
from thrusting import FIVE, with_thrust
from trials import Errors, frequency, wilson

from benchmarks.fallback import rule
from cli.jobs.planner import planner_of
from pipeline.errors import InputError
from pipeline.expert import solve
from pipeline.networks.architecture import find
from pipeline.networks.encoding import Encoding
from pipeline.networks.model import Model
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.thrust import Thrust
from pipeline.plan.plan import SOLVED, UNSAFE
from pipeline.plan.requirements import Requirements, RiskLimit
from pipeline.planners.as_flown import AsFlown
from pipeline.planners.goal_assignment import GoalAssignment
from pipeline.planners.network import NetworkPlanner, Seeded
from pipeline.scenario import draw
from pipeline.scenario.spacecraft import Spacecraft

FOUR = draw("coplanar-split", 0, 4, 4, Problem(), "valid")
SWARM = replace(FOUR, initial=FOUR.initial[:3], goal=FOUR.goal[:3])
COARSE = replace(SWARM, problem=Problem(nodes=5, time_step=SWARM.problem.duration / 4))
"""For mixed-integer programs that are solved again and again, for a plan as flown."""
ORBITS = 0.3
RISK = RiskLimit(1e-2, navigation_sigma=0.2, thrust_sigma=0.01)
ERRORS = Errors(0.2, 0.2 * SWARM.problem.mean_motion, 0.01)
TRIALS = 500

NODES, ADRIFT, RISKY, LIMIT, OPTIMAL = "nodes", "passive safety", "risk", "thrust limit", "optimal"
OPTIONS = {
    NODES: {"separation": "nodes"},
    ADRIFT: {"passive_safety": ORBITS},
    RISKY: {"risk": RISK},
    LIMIT: {},
    OPTIMAL: {},
}
PAIRS = [*combinations(OPTIONS, 2)]


def untrained(name):
    """A network before training, for swarms of this size."""
    found = find(name)
    encoding = Encoding(SWARM.problem, SWARM.n, "line", "states", (1.0,) * 6, (1.0,) * 6)
    torch.manual_seed(0)
    network = found.network(found.config, encoding, 0.0)
    return Model(name, found.config, "paper", encoding, network)


def named(name, effort=None, *, raw=False):
    return lambda asked: planner_of(name, asked, effort, raw=raw)


def best(asked):
    """The expert's best effort, with two searches instead of eight."""
    found = planner_of("expert", asked, "best")
    return replace(found, settings=replace(found.settings, starts=2))


PLANNERS = {
    "expert, first": named("expert", "first"),
    "expert, default": named("expert"),
    "expert, best": best,
    **{name: named(name) for name in ("straight-line", "minimum-energy", "decoupled-optimum")},
    "refiner": named("refiner", raw=True),
    "refiner + expert": named("refiner"),
    "rule": lambda asked: rule(4, requirements=asked),
    "network": lambda asked: NetworkPlanner(untrained("ff1"), "ff1", asked),
    "network + expert": lambda asked: Seeded(NetworkPlanner(untrained("ff1"), "ff1", asked)),
}
ENDS_IN_EXPERT = [name for name in PLANNERS if "expert" in name]


@pytest.fixture(scope="module")
def limited():
    """The swarm, with less thrust than its unlimited plan uses."""
    most = 0.9 * float(np.abs(solve(SWARM).controls).max())
    return replace(SWARM, problem=replace(SWARM.problem, max_acceleration=most))


def planned(planner, options, limited):
    """The scenario that is flown and the plan, or the refusal."""
    scenario = limited if LIMIT in options else SWARM
    told = {name: value for one in options for name, value in OPTIONS[one].items()}
    try:
        found = PLANNERS[planner](Requirements(**told))
    except InputError as error:
        return None, str(error)
    (plan,) = (GoalAssignment(found) if OPTIMAL in options else found).plan([scenario])
    return plan.scenario, plan


def broken(scenario, plan, options):
    """What the judge finds that is not as it was asked for, or not as the certificate says."""
    told = {name: getattr(plan, name) for name in ("states", "controls", "assignment")}
    told["certificate"] = asdict(plan.certificate)
    report = judge_plan(document(scenario), told, at_nodes=NODES in options)
    assert report.false_claims == ()
    yield from report.faults
    case = Case.of(document(scenario))
    if RISKY in options:
        hits = frequency(case, scenario.initial, plan.controls, ERRORS, TRIALS)
        if wilson(hits, TRIALS)[0] > RISK.asked:
            yield f"{hits} of {TRIALS} flights are too close"


@pytest.mark.parametrize("options", PAIRS, ids=" and ".join)
@pytest.mark.parametrize("planner", PLANNERS)
def test_options_together_are_kept_or_refused_in_a_sentence(planner, options, limited):
    scenario, plan = planned(planner, options, limited)
    if scenario is None:
        assert NODES in options and {ADRIFT, RISKY} & {*options}
        assert plan.endswith("leave one of the two out.")
        return
    certificate = plan.certificate
    orbits = certificate.passive_safety and certificate.passive_safety.orbits
    assert orbits == (ORBITS if ADRIFT in options else None)
    asked = certificate.risk and certificate.risk.asked
    assert asked == (RISK.asked if RISKY in options else None)
    found = [*broken(scenario, plan, options)]
    if plan.status == SOLVED:
        assert found == []
    else:
        assert planner not in ENDS_IN_EXPERT, "there is a plan that keeps both"
        assert plan.status == UNSAFE
        assert plan.message
        assert found or certificate.risk.bound > RISK.asked, "it is called unsafe and is safe"


@pytest.mark.parametrize("planner", ["expert, default", "refiner + expert"])
def test_plans_without_the_options_break_each_of_them(planner, limited):
    """So that an option that is lost on the way is seen."""
    _, plan = planned(planner, (), limited)
    case = Case.of(document(SWARM))
    assert plan.status == SOLVED
    assert closest_adrift(case, plan.states, plan.controls, ORBITS).distance < case.radius
    assert [*broken(SWARM, plan, (RISKY,))]
    assert np.abs(plan.controls).max() > limited.problem.max_acceleration


WORLD = ReferenceOrbit(6878e3, 0.001, 97.4)
WINDOW = ((300.0, 500.0),)
BUDGETS = tuple(Spacecraft(delta_v=4.0, no_burn=((0.0, 100.0),) * k) for k in (0, 1, 0))
KINDS = {
    "norm": (Thrust("norm", 0.02), ()),
    "directions": (Thrust(FIVE), ()),
    "windows": (Thrust(no_burn=WINDOW), BUDGETS),
    "fair": (Thrust("norm", objective="fair"), BUDGETS),
    "bits": (Thrust(min_delta_v=0.01), ()),
    "pointed bits": (Thrust("norm", min_delta_v=0.01), BUDGETS),
}


def judged_faults(scenario, plan):
    """What the judge finds wrong with a plan, of linear motion also its claims."""
    if not plan.as_flown:
        told = {name: getattr(plan, name) for name in ("states", "controls", "assignment")}
        return judge_plan(
            document(scenario), told | {"certificate": asdict(plan.certificate)}
        ).wrong
    thrusters = Case.of(document(scenario), scenario.n).thrusters
    return tuple(thrusters.faults(plan.controls, scenario.problem.time_step))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("planner", PLANNERS)
def test_every_planner_keeps_what_is_said_of_thrust_or_calls_its_plan_unsafe(planner, kind):
    scenario = with_thrust(SWARM, *KINDS[kind])
    (plan,) = PLANNERS[planner](Requirements()).plan([scenario])
    wrong = judged_faults(scenario, plan)
    if plan.status == SOLVED:
        assert wrong == ()
    else:
        assert planner not in ENDS_IN_EXPERT, plan.message
        assert (plan.status, bool(plan.message)) == (UNSAFE, True)
        assert wrong and not any("is said" in one for one in wrong)


@pytest.mark.parametrize("options", ["adrift", "risk", "optimal", "world", "optimal world", "best"])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("planner", ["expert, default", "refiner + expert"])
def test_what_is_said_of_thrust_is_kept_with_all_else_or_refused(planner, kind, options):
    swarm = COARSE if kind == "bits" and "world" in options else SWARM
    scenario = with_thrust(swarm, *KINDS[kind])
    told = {"adrift": {"passive_safety": ORBITS}, "risk": {"risk": RISK}}.get(options, {})
    found = (best if options == "best" else PLANNERS[planner])(Requirements(**told))
    if "optimal" in options:
        found = GoalAssignment(found)
    if "world" in options:
        found = AsFlown(found, WORLD)
    try:
        (plan,) = found.plan([scenario])
    except InputError as refused:
        assert kind == "fair" and "optimal" in options
        assert str(refused).endswith("leave the assignment out.")
        return
    assert plan.status == SOLVED, plan.message
    scenario = plan.scenario
    assert judged_faults(scenario, plan) == ()
    if options == "adrift":
        assert plan.certificate.passive_safety.orbits == ORBITS
    if options == "risk":
        hits = frequency(Case.of(document(scenario)), scenario.initial, plan.controls, ERRORS, 200)
        assert wilson(hits, 200)[0] <= RISK.asked
