"""Whatever is asked of a plan together is kept by every planner, or refused in a sentence."""

from dataclasses import asdict, replace
from itertools import combinations

import numpy as np
import pytest
import torch
from judge import Case, closest_adrift, judge_plan
from judged import document
from trials import Errors, frequency, wilson

from benchmarks.fallback import rule
from cli.jobs.planner import planner_of
from pipeline.errors import InputError
from pipeline.expert import solve
from pipeline.networks.architecture import find
from pipeline.networks.encoding import Encoding
from pipeline.networks.model import Model
from pipeline.orbit.problem import Problem
from pipeline.plan import SOLVED, UNSAFE, Requirements, RiskLimit
from pipeline.planners.goal_assignment import GoalAssignment
from pipeline.planners.network import NetworkPlanner, Seeded
from pipeline.scenario import draw

FOUR = draw("coplanar-split", 0, 4, 4, Problem(), "valid")
SWARM = replace(FOUR, initial=FOUR.initial[:3], goal=FOUR.goal[:3])
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
