"""A page believes no claim: what it says of a plan is found anew from its controls."""

from dataclasses import replace

import numpy as np
import pytest
from thrusting import FIVE, with_thrust

from pipeline.errors import InputError
from pipeline.expert import decoupled_optima, solve, within_risk
from pipeline.orbit.problem import Problem
from pipeline.orbit.thrust import Thrust
from pipeline.plan.certificate import Feedback
from pipeline.plan.document import plan_document
from pipeline.plan.judge import Draft, certified_plan
from pipeline.plan.plan import SOLVED, UNSOLVED, summary
from pipeline.plan.recheck import recheck
from pipeline.plan.requirements import Requirements, RiskLimit
from pipeline.planners.classical import BASELINES, Expert
from pipeline.scenario import Scenario, draw
from pipeline.scenario.spacecraft import Spacecraft
from pipeline.show.tables import certificate_rows, verdict

SCENARIO = draw("rings", 0, 10, 3, Problem())


@pytest.fixture(scope="module")
def plan():
    return solve(SCENARIO)


@pytest.fixture(scope="module")
def unsafe():
    """Each craft's own optimum: some pass each other too close."""
    own = decoupled_optima(SCENARIO.initial, SCENARIO.goal, SCENARIO.problem)
    draft = Draft(own.controls, float(own.lower_bound.sum()))
    made = certified_plan("decoupled optimum", SCENARIO, draft)
    assert made.status == "unsafe"
    return made


def said(plan, scenario=SCENARIO):
    shown = recheck(plan)
    return verdict(shown, plan.status)


def test_a_true_plan_is_safe_without_a_fault(plan):
    shown = recheck(plan)
    assert (shown.safe, shown.faults) == (True, ())
    assert shown.plan.certificate == plan.certificate
    assert said(plan).good


def test_an_unsafe_plan_names_the_pair_and_the_time(unsafe):
    found = said(unsafe)
    i, j = unsafe.certificate.min_separation_pair
    assert (found.good, found.headline) == (False, "Unsafe")
    assert f"craft {i} and {j} come within {unsafe.certificate.min_separation:.6g} m" in " ".join(
        found.reasons
    )
    assert f"{unsafe.certificate.min_separation_time:.6g} s" in " ".join(found.reasons)


def test_what_an_unsafe_plan_says_of_itself_is_said_once(unsafe):
    (fault,) = recheck(unsafe).faults
    assert fault.startswith("The plan is unsafe: craft ")


def test_a_plan_that_only_claims_to_be_solved_is_found_out(unsafe):
    claim = replace(unsafe.certificate, min_separation=40.0, min_separation_bound=39.9)
    liar = replace(unsafe, status=SOLVED, message="", certificate=claim)
    found = said(liar)
    assert (found.good, found.headline) == (False, "Unsafe")
    assert any("come within" in reason for reason in found.reasons)
    assert any("claims min_separation 40 m" in reason for reason in found.reasons)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *(("fuel", 1e-3), ("fuel", float("nan")), ("delta_v", 0.1), ("node_collisions", 3)),
        *(("min_separation_bound", 200.0), ("fuel_lower_bound", 1.0)),
        ("fuel_lower_bound", float("nan")),
    ],
)
def test_a_false_number_is_named_with_the_true_one(plan, field, value):
    found = said(replace(plan, certificate=replace(plan.certificate, **{field: value})))
    assert (found.good, found.headline) == (False, "Not as claimed")
    assert f"The file claims {field} {value:.6g}" in found.reasons[0]


def test_states_that_the_controls_do_not_lead_to_are_told(plan):
    moved = plan.states.copy()
    moved[4, 3, 1] += 5.0
    found = said(replace(plan, states=moved))
    assert not found.good
    assert "up to 5 m from where its controls lead" in found.reasons[0]
    shown = recheck(replace(plan, states=moved)).plan.states
    np.testing.assert_allclose(shown, plan.states, atol=1e-9)


def test_a_goal_that_is_missed_is_told(plan):
    idle = replace(plan, controls=np.zeros_like(plan.controls))
    assert any("Misses its goal by" in reason for reason in said(idle).reasons)


def test_an_infeasible_plan_says_so_and_has_no_gap():
    scenario = draw("rings", 0, 2, 0, Problem(max_acceleration=1e-6))
    plan = solve(scenario)
    found = said(plan, scenario)
    assert (found.good, found.headline) == (False, "Infeasible")
    assert "cannot reach its goal within max_acceleration" in found.reasons[0]
    rows = dict(certificate_rows(recheck(plan).plan, plan.status))
    assert rows["Gap to that bound"] == "–"


def test_a_plan_that_misses_its_goal_has_no_gap_and_a_bound_above_its_fuel_is_no_false_claim(plan):
    bound = plan.certificate.fuel_lower_bound
    short = certified_plan("one", SCENARIO, Draft(0.5 * plan.controls, bound))
    assert short.status == UNSOLVED
    assert short.certificate.fuel < bound
    assert "gap" not in repr(short)
    assert summary(short)["optimality_gap"] is None
    assert plan_document(short)["certificate"]["optimality_gap"] is None
    shown = recheck(short)
    assert not any("claims" in fault for fault in shown.faults)
    for status in (short.status, SOLVED):  # also where the file says otherwise
        assert dict(certificate_rows(shown.plan, status))["Gap to that bound"] == "–"
    false = replace(plan, certificate=replace(plan.certificate, fuel_lower_bound=2 * bound))
    assert any("claims fuel_lower_bound" in fault for fault in recheck(false).faults)


def test_a_gap_to_a_bound_of_nothing_is_no_number(plan):
    found = replace(plan.certificate, fuel_lower_bound=0.0, optimality_gap=np.inf)
    gap = dict(certificate_rows(replace(plan, certificate=found), plan.status))["Gap to that bound"]
    assert gap.startswith("unknown")
    assert "inf" not in gap


def test_controls_beyond_all_measure_are_refused_in_a_sentence(plan):
    with pytest.raises(InputError, match=r"controls reach 1e\+200 m/s²"):
        recheck(replace(plan, controls=np.full_like(plan.controls, 1e200)))


@pytest.mark.parametrize("orbits", [0.5, 1.0])
@pytest.mark.parametrize("off", [1e-4, 1e-7, 1e-8, 1e-9, 1e-12])
def test_plans_of_time_steps_near_half_and_whole_orbits_can_be_shown(orbits, off):
    """Where the controls would be too large to compute with, a planner lets the craft coast."""
    step = (1 + off) * orbits * 2 * np.pi / Problem.mean_motion
    scenario = replace(SCENARIO, problem=Problem(time_step=step))
    for planner in (*BASELINES, Expert()):
        (made,) = planner.plan([scenario])
        assert bool(recheck(made).faults) == (made.status != SOLVED)


def test_a_proven_bound_is_never_rounded_up(plan):
    rows = dict(certificate_rows(plan, plan.status))
    shown = float(rows["Proven: no pair is ever closer than"].removesuffix(" m"))
    assert 0 <= plan.certificate.min_separation_bound - shown < 1e-4


def test_a_risk_is_found_anew_and_a_false_one_named(plan):
    limit = Requirements(risk=RiskLimit(0.01, navigation_sigma=0.2, thrust_sigma=0.01))
    careful = within_risk(plan, limit)
    shown = recheck(careful)
    assert (shown.faults, careful.status) == ((), SOLVED)
    found = careful.certificate
    risk = found.risk
    rows = dict(certificate_rows(shown.plan, SOLVED))
    assert rows["Risk of a pair within r_col in open loop, at most"] == f"{risk.bound:.3g}"
    assert rows["Asked for"] == "0.01"
    asked = replace(risk, asked=risk.bound / 2)
    (fault,) = recheck(replace(careful, certificate=replace(found, risk=asked))).faults
    assert fault.startswith("The risk that a pair comes within 15 m is bounded by")
    for share in (1 / 2, 0.97):
        less = replace(found, risk=replace(risk, bound=share * risk.bound))
        (fault,) = recheck(replace(careful, certificate=less)).faults
        assert fault.startswith(f"The file claims risk.bound {less.risk.bound:.6g}, its controls")


def test_a_risk_with_a_pointed_thruster_is_found_anew_unless_it_is_of_feedback():
    scenario = with_thrust(draw("rings", 0, 2, 0, Problem()), Thrust("norm"))
    careful = within_risk(solve(scenario), Requirements(risk=RiskLimit(0.1, navigation_sigma=0.1)))
    assert recheck(careful).faults == ()
    fed_back = replace(careful.certificate.risk, feedback=Feedback(0.0, 0.0))
    with pytest.raises(InputError, match="a risk is asked for in closed loop"):
        recheck(replace(careful, certificate=replace(careful.certificate, risk=fed_back)))


def test_what_a_file_claims_of_a_loss_of_thrust_is_found_anew(plan):
    """The plan was made without asking for it, and its craft drift too close."""
    made = Draft(plan.controls, plan.certificate.fuel_lower_bound)
    asked = certified_plan("expert", SCENARIO, made, Requirements(passive_safety=1.0))
    assert asked.status == "unsafe"
    claim = replace(
        asked.certificate.passive_safety, min_separation=16.0, min_separation_bound=15.9
    )
    liar = replace(plan, certificate=replace(plan.certificate, passive_safety=claim))
    found = said(liar)
    assert (found.good, found.headline) == (False, "Unsafe")
    assert any("adrift from" in reason for reason in found.reasons)
    assert any("passive_safety.min_separation_bound" in reason for reason in found.reasons)
    endless = replace(claim, orbits=1e12)
    with pytest.raises(InputError, match="at most 100"):
        recheck(replace(plan, certificate=replace(plan.certificate, passive_safety=endless)))


@pytest.mark.parametrize("name", ["craft_delta_v", "craft_delta_v_2norm"])
def test_a_false_delta_v_of_a_craft_is_told(plan, name):
    true = getattr(plan.certificate, name)
    lie = replace(plan.certificate, **{name: (*true[:4], true[4] / 2, *true[5:])})
    assert any(
        f"claims {name}[4]" in reason for reason in said(replace(plan, certificate=lie)).reasons
    )


LEFT = tuple(Spacecraft(delta_v=4.0 + k) for k in range(10))
ASKED = {
    "largest_share": (Thrust("norm", objective="fair"), LEFT),
    "smallest_burn": (Thrust("norm", min_delta_v=0.02), ()),
    "craft_delta_v_thrusters": (Thrust(FIVE), ()),
}
FORGED = {
    "share": ("largest_share", {"share": 0.01}, "largest_share.share 0.01"),
    "craft": ("largest_share", {"craft": 9}, "largest_share.craft 9"),
    "bound": ("largest_share", {"bound": 0.99}, "largest_share.bound 0.99"),
    "least": ("smallest_burn", {"least": 0.5}, "smallest_burn.least 0.5 m/s"),
    "asked": ("smallest_burn", {"asked": 0.001}, "smallest_burn.asked 0.001 m/s"),
    "thrusters": ("craft_delta_v_thrusters", None, "craft_delta_v_thrusters[0] 0 m/s"),
}


@pytest.mark.parametrize("forged", FORGED)
def test_claims_of_thrust_are_found_anew(forged):
    name, change, fault = FORGED[forged]
    plan = solve(with_thrust(SCENARIO, *ASKED[name]))
    shown = recheck(plan)
    assert (shown.faults, shown.plan.certificate) == ((), plan.certificate)
    true = getattr(plan.certificate, name)
    false = (0.0,) * 10 if change is None else replace(true, **change)
    forged_plan = replace(plan, certificate=replace(plan.certificate, **{name: false}))
    (said_so,) = recheck(forged_plan).faults
    assert f"The file claims {fault}, its controls give" in said_so
    if change is not None:
        missing = replace(plan, certificate=replace(plan.certificate, **{name: None}))
        assert recheck(missing).faults


def test_a_bound_hardly_above_what_is_burned_is_false():
    """By a hundred-thousandth, and one below by as much may be true."""
    left = (Spacecraft(delta_v=4.0), Spacecraft(delta_v=5.0))
    plan = solve(
        with_thrust(draw("rings", 0, 2, 0, Problem()), Thrust("norm", objective="fair"), left)
    )
    for by, false in ((1 + 1e-5, True), (1 - 1e-5, False)):
        share = replace(
            plan.certificate.largest_share, bound=by * plan.certificate.largest_share.share
        )
        claims = replace(
            plan.certificate, fuel_lower_bound=by * plan.certificate.fuel, largest_share=share
        )
        faults = recheck(replace(plan, certificate=claims)).faults
        assert [one.split()[3] for one in faults] == [
            "largest_share.bound",
            "fuel_lower_bound",
        ] * false


def test_a_plan_that_burns_nothing_has_no_fault():
    """Two craft at rest along-track: their goals are where they start."""
    there = np.array([[0.0, 100.0 * k, 0, 0, 0, 0] for k in range(2)])
    plan = solve(Scenario(Problem(), there, there))
    assert plan.certificate.fuel == 0
    assert recheck(plan).faults == ()


@pytest.mark.parametrize(
    "thrust, craft, fault",
    [
        (Thrust("norm", 1e-4), (), "uses more than its max_acceleration_norm"),
        (Thrust("norm", no_burn=((0.0, 100.0),)), (), "burns in a stretch of no_burn"),
        (Thrust("norm", min_delta_v=5.0), (), "has a burn smaller than min_delta_v"),
        (Thrust("norm"), (Spacecraft(delta_v=1e-3),) * 10, "burns more than its delta_v"),
    ],
)
def test_a_plan_that_exceeds_what_its_scenario_says_of_thrust_is_not_solved(thrust, craft, fault):
    plan = solve(with_thrust(SCENARIO, Thrust("norm")))
    liar = replace(plan, scenario=with_thrust(SCENARIO, thrust, craft))
    shown = recheck(liar)
    assert any(fault in one for one in shown.faults)
    assert shown.plan.status == "unsafe"
