"""GoalAssignment craft: the plan is sound, its bound holds for every order, and it says so."""

from dataclasses import asdict, replace
from itertools import permutations

import numpy as np
import pytest
from judge import Case, judge_plan, least_fuel
from judge.fuel import least_fuel_inside
from judged import document

from pipeline.expert import Settings, solve
from pipeline.orbit.corridors import Box, Corridor
from pipeline.orbit.participants import Obstacle
from pipeline.orbit.problem import Problem
from pipeline.orbit.rings import pro_states
from pipeline.plan.document import plan_document
from pipeline.plan.plan import INFEASIBLE, SOLVED, UNSAFE, UNSOLVED
from pipeline.plan.requirements import Requirements
from pipeline.planners.classical import Expert
from pipeline.planners.goal_assignment import LARGE_GAP, GoalAssignment, decoupled_costs, ranked
from pipeline.planners.named import named_planner
from pipeline.scenario import Scenario, draw
from pipeline.scenario.document import document_of
from pipeline.scenario.spacecraft import Spacecraft
from pipeline.scenario.waypoint import Waypoint


def valid(family, n, index, problem=None):
    return draw(family, 5, n, index, problem or Problem(), "valid")


def judged(scenario, plan):
    """The judge's report on a plan for a scenario of interchangeable craft."""
    assert (plan.scenario.goal == scenario.goal[list(plan.assignment.slots)]).all()
    fields = {"states": plan.states, "controls": plan.controls, "assignment": True}
    return judge_plan(document(plan.scenario), {**fields, "certificate": asdict(plan.certificate)})


@pytest.mark.parametrize(("family", "n"), [("rings", 5), ("dense", 10), ("rotation", 9)])
def test_the_judge_finds_the_plan_sound_and_the_bound_that_of_all_orders(family, n):
    scenarios = [valid(family, n, k) for k in range(3)]
    for scenario, plan in zip(scenarios, GoalAssignment(Expert()).plan(scenarios), strict=True):
        assert plan.status == SOLVED
        assert judged(scenario, plan).wrong == ()
        assert sorted(plan.assignment.slots) == list(range(n))


def test_no_order_of_four_craft_is_planned_for_less():
    """All 24 orders, each by the expert at its best: none is cheaper, none is below the bound."""
    scenario = valid("dense", 4, 0)
    (plan,) = GoalAssignment(Expert()).plan([scenario])
    plans = [solve(scenario.taking(order)) for order in permutations(range(4))]
    cheapest = min(one.certificate.fuel for one in plans if one.status == SOLVED)
    assert plan.certificate.fuel <= cheapest * (1 + LARGE_GAP)
    assert plan.certificate.fuel_lower_bound <= cheapest * (1 + 1e-9)
    assert plan.certificate.fuel_lower_bound == pytest.approx(
        min(one.certificate.fuel_lower_bound for one in plans), rel=1e-9
    )


def test_what_is_saved_is_what_the_given_order_needs_at_least():
    scenario = valid("rings", 6, 1)
    (plan,) = GoalAssignment(Expert()).plan([scenario])
    truth = judge_plan(document(scenario), asdict(solve(scenario))).fuel_lower_bound
    told = plan.assignment
    assert told.given_fuel_lower_bound == pytest.approx(truth, rel=1e-6)
    assert told.saving == pytest.approx(1 - plan.certificate.fuel / truth, abs=1e-6)
    assert solve(scenario).certificate.fuel * (1 - told.saving) >= plan.certificate.fuel * (
        1 - 1e-6
    )


def test_where_the_cheapest_assignment_is_dear_the_next_best_are_tried():
    """The kept plan is the cheapest of those tried, and costs less than the first one's."""
    better = 0
    for scenario in (valid("dense", 10, k) for k in range(15)):
        alone = GoalAssignment(Expert(), most=1).plan([scenario])[0]
        (plan,) = GoalAssignment(Expert()).plan([scenario])
        assert plan.certificate.fuel <= alone.certificate.fuel
        assert plan.assignment.tried >= alone.assignment.tried
        dear = alone.certificate.optimality_gap > LARGE_GAP
        assert (plan.assignment.tried > 1) <= dear
        if plan.assignment.rank != 1:
            better += 1
            assert plan.certificate.fuel < alone.certificate.fuel
            assert judged(scenario, plan).wrong == ()
            costs = decoupled_costs(scenario)
            assert costs.of(plan.assignment.slots) > plan.certificate.fuel_lower_bound
    assert better


def test_a_planner_that_keeps_none_apart_is_asked_until_an_assignment_is_safe():
    planner = named_planner("decoupled-optimum")
    found = {SOLVED: 0, UNSAFE: 0}
    for scenario in (valid("dense", 6, k) for k in range(20)):
        (plan,) = GoalAssignment(planner).plan([scenario])
        found[plan.status] += plan.assignment.tried > 1
        if plan.status == SOLVED:
            assert judged(scenario, plan).wrong == ()
        else:
            i, j = plan.certificate.min_separation_pair
            assert f"craft {i} and {j} come within" in plan.message
            assert (plan.assignment.rank, plan.assignment.saving) == (1, None)
    assert all(found.values())


def test_craft_that_cannot_reach_the_goals_given_reach_those_of_others():
    problem = Problem(max_acceleration=5e-4)
    scenario = valid("rings", 10, 0, problem)
    assert solve(scenario).status == INFEASIBLE
    (plan,) = GoalAssignment(Expert()).plan([scenario])
    assert plan.status == SOLVED
    assert judged(scenario, plan).wrong == ()
    assert (plan.assignment.given_fuel_lower_bound, plan.assignment.saving) == (None, None)


def test_where_no_order_can_be_flown_that_is_said():
    scenario = valid("rings", 4, 0, Problem(max_acceleration=1e-6))
    case = Case.of(document(scenario))
    for j in range(4):
        every = least_fuel(case, scenario.initial, scenario.goal[[j] * 4])
        assert np.isinf(every.attained).all()
    (plan,) = GoalAssignment(Expert()).plan([scenario])
    assert plan.status == INFEASIBLE and plan.assignment is None
    assert "max_acceleration" in plan.message
    scenario = replace(valid("rings", 4, 0), craft=(Spacecraft(delta_v=1e-6),) * 4)
    (plan,) = GoalAssignment(Expert()).plan([scenario])
    assert plan.status == INFEASIBLE
    assert "cannot reach its own within its limits of thrust and delta_v" in plan.message
    coasting = Spacecraft(no_burn=((0.0, scenario.problem.duration),))
    (plan,) = GoalAssignment(Expert()).plan([replace(scenario, craft=(coasting,) * 4)])
    assert plan.status == INFEASIBLE
    unlimited = "with any thrust, however large, in the intervals in which it may burn"
    assert f"cannot reach its own {unlimited}" in plan.message


def test_goals_in_the_best_order_already_stay_where_they_are():
    scenario = valid("rings", 5, 0)
    (plan,) = GoalAssignment(Expert()).plan([scenario])
    sorted_out = scenario.taking(plan.assignment.slots)
    (again,) = GoalAssignment(Expert()).plan([sorted_out])
    assert again.assignment.slots == (0, 1, 2, 3, 4)
    assert again.assignment.saving == pytest.approx(0, abs=1e-2)
    assert again.certificate.fuel == pytest.approx(plan.certificate.fuel)


ADRIFT = Requirements(passive_safety=1.0)


def test_what_refutes_one_assignment_is_not_said_of_all():
    """The cheapest is in its own way after a loss of thrust; the judge finds another's plan sound,
    with the bound of all."""
    scenario = draw("independent", 7, 5, 0, Problem())
    (plan,) = GoalAssignment(Expert(requirements=ADRIFT)).plan([scenario])
    assert solve(
        scenario.taking(next(ranked(decoupled_costs(scenario).fuel))), requirements=ADRIFT
    ).status == (INFEASIBLE)
    assert plan.status == SOLVED
    assert judged(scenario, plan).wrong == ()


def between_starts(n, first, last, radius):
    """Scenario from the initial states of one random draw to those of another."""
    ends = [draw("independent", 7, n, k, Problem()).initial for k in (first, last)]
    return Scenario(Problem(collision_radius=radius), *ends)


def test_no_plan_is_said_to_be_possible_only_where_every_order_is_refuted():
    """All orders of three craft, each by the expert; they start and end on the same few orbits.

    The last has orders that are in nobody's way after a loss of thrust until they are planned.
    """
    found = set()
    for index, other in (*((k, k + 50) for k in range(8)), (45, 195)):
        scenario = between_starts(3, index, other, 60.0)
        (plan,) = GoalAssignment(Expert(requirements=ADRIFT)).plan([scenario])
        truth = [
            solve(scenario.taking(order), requirements=ADRIFT).status
            for order in permutations(range(3))
        ]
        assert (plan.status == SOLVED) == (SOLVED in truth)
        assert (plan.status == INFEASIBLE) == (set(truth) == {INFEASIBLE})
        found.add(plan.status)
    assert len(found) > 1


def test_nothing_is_proven_of_orders_that_were_not_tried():
    """All 24 orders of four craft collide in the only flight they have; 17 of them are flown."""
    scenario = draw("dense", 5, 4, 10, Problem(nodes=3, time_step=600.0, collision_radius=30.0))
    (plan,) = GoalAssignment(Expert(Settings(max_rounds=0))).plan([scenario])
    assert plan.status == UNSOLVED
    assert plan.message.startswith("no plan found for 17 assignments; for this one, ")


def test_an_order_that_was_merely_not_solved_is_not_refuted_with_another():
    """One of two orders is infeasible; for the other the expert, given no rounds, has no plan."""
    scenario = between_starts(2, 20, 70, 60.0)
    orders = [scenario.taking(one) for one in permutations(range(2))]
    assert {solve(one, requirements=ADRIFT).status for one in orders} == {INFEASIBLE, SOLVED}
    (plan,) = GoalAssignment(Expert(Settings(max_rounds=0), requirements=ADRIFT)).plan([scenario])
    assert plan.status == UNSOLVED and plan.assignment.tried == 2


def along_track(*y):
    """States of craft at rest at along-track positions, m."""
    at = np.array(y, dtype=float)
    return pro_states(1e-9, 0.0, np.zeros(len(at)), 0.0, Problem().mean_motion, at)


# On an ellipse 200 m long, through the place at 1400 m once in each orbit, after the transfer, and
# far from all others
(PASSING,) = pro_states(100.0, 0.0, -np.ones(1), 0.0, Problem().mean_motion, np.array([1500.0]))


@pytest.mark.parametrize(
    ("goal", "state"),
    [
        ((10, -10, 800, 1000, 1400), (0.0, 5000.0, 0.0, 0.0, 0.0, 0.0)),
        ((50, -50, 800, 1000, 1400), PASSING),
    ],
)
def test_with_an_obstacle_every_order_that_drifts_into_something_is_refuted(goal, state):
    """In the way of two goals is a craft that stays where it starts, and of one the obstacle."""
    ends = along_track(0, 300, 600, 900, 1200), along_track(*goal)
    scenario = Scenario(Problem(), *ends, obstacles=(Obstacle("debris", tuple(state), radius=5.0),))
    (plan,) = GoalAssignment(Expert(requirements=ADRIFT)).plan([scenario])
    assert plan.status == INFEASIBLE
    assert "whichever goals they take, a craft adrift" in plan.message


STARTS, GOALS = along_track(0, 300, 600, 900, 1200), along_track(60, 360, 660, 960, 1260)
SMALL, LARGE = Spacecraft(radius=2.0), Spacecraft(radius=7.5)
# Of two craft that must be 10 m apart after half of the time
MET = tuple(Waypoint(k, (0.0, 10.0 * k, 0.0), time=600.0) for k in range(2))


@pytest.mark.parametrize(
    "close",
    [
        {"initial": along_track(0, 14.9, 600, 900, 1200)},
        {"goal": along_track(60, 360, 660, 960, 974.9)},
        {"initial": along_track(0, 14.9, 600, 900, 1200), "craft": (LARGE,) * 2 + (SMALL,) * 3},
        {"goal": along_track(60, 360, 660, 960, 963.9), "craft": (LARGE,) * 2 + (SMALL,) * 3},
        {"obstacles": (Obstacle("debris", (0.0, 1260.0, 0.0, 0.0, 0.0, 0.0), radius=5.0),)},
        {"waypoints": MET},
    ],
    ids=[
        "starts",
        "goals",
        "starts of large craft",
        "goals for small ones",
        "obstacle",
        "waypoints",
    ],
)
def test_states_too_close_whoever_takes_which_goal_leave_no_plan(close):
    """Of craft at rest, some of which are of half the collision radius of 15 m, others of 2 m."""
    scenario = Scenario(**{"problem": Problem(), "initial": STARTS, "goal": GOALS, **close})
    (plan,) = GoalAssignment(Expert()).plan([scenario])
    assert (plan.status, plan.assignment.tried) == (INFEASIBLE, 1)
    assert plan.message.startswith("whichever goals they take, states that they must have are too")


def test_goals_too_close_for_some_craft_are_taken_by_others():
    """11 m apart, for craft of 7.5 m radius, which they cannot be, and of 2 m."""
    goal = along_track(60, 71, 660, 960, 1260)
    scenario = Scenario(Problem(), STARTS, goal, craft=(LARGE,) * 2 + (SMALL,) * 3)
    (plan,) = GoalAssignment(Expert()).plan([scenario])
    assert solve(scenario).status == INFEASIBLE
    assert plan.status == SOLVED and len({0, 1} & set(plan.assignment.slots[:2])) < 2


def test_a_craft_in_the_way_of_two_goals_is_in_the_way_whoever_takes_them():
    """It stays where it starts, and each of two goals is 10 m beside it."""
    e = Problem().mean_motion
    initial = pro_states(1e-9, 0.0, np.zeros(3), 0.0, e, np.array([0.0, 300.0, 600.0]))
    goal = pro_states(1e-9, 0.0, np.zeros(3), 0.0, e, np.array([10.0, -10.0, 900.0]))
    (plan,) = GoalAssignment(Expert(requirements=ADRIFT)).plan([Scenario(Problem(), initial, goal)])
    assert plan.status == INFEASIBLE
    assert "whichever goals they take, a craft adrift" in plan.message


def in_a_row(*corridors):
    """Six craft at rest in a row, and a goal 30 m ahead of each."""
    row = np.zeros((6, 6))
    row[:, 1] = np.arange(0.0, 600.0, 100.0)
    return Scenario(Problem(), row, row + 30 * np.eye(6)[1], corridors=corridors)


def behind(y, begin):
    """A corridor of craft 0, from y on along-track, up to the last node."""
    box = Box((-1e3, y, -1e3), (1e3, 1e3, 1e3))
    return Corridor(box, begin, Problem().duration, (0,))


def test_a_goal_outside_a_corridor_is_not_taken_however_cheap_it_is():
    """Hundreds of assignments cost less than those that send craft 0 to the last place."""
    last = behind(500.0, Problem().duration)
    scenario = in_a_row(last)
    (plan,) = GoalAssignment(Expert()).plan([scenario])
    assert plan.status == SOLVED and plan.assignment.slots[0] == 5
    for free in ((5, 0, 1, 2, 3, 4), (5, 1, 2, 3, 4, 0)):
        fuel = solve(replace(scenario, corridors=()).taking(free)).certificate.fuel_lower_bound
        assert plan.certificate.fuel <= fuel * 1.01


@pytest.mark.parametrize("corridor", [behind(700.0, Problem().duration), behind(100.0, 0.0)])
def test_where_an_end_is_outside_a_corridor_for_every_order_there_is_proven_to_be_no_plan(corridor):
    (plan,) = GoalAssignment(Expert()).plan([in_a_row(corridor)])
    assert plan.status == INFEASIBLE
    assert "whichever goals they take, some craft is outside of a corridor" in plan.message


def inside_by_pair(scenario):
    """Minimum fuel of each craft to each goal within its corridors, m/s², by linear programs."""
    craft, found = np.arange(scenario.n), np.zeros((scenario.n, scenario.n))
    for shift in craft:
        slots = (craft + shift) % scenario.n
        taken = scenario.taking(slots.tolist())
        given = document_of(taken)
        found[craft, slots] = least_fuel_inside(given, Case.of(given), taken.initial, taken.goal)
    return found


def test_the_costs_of_goals_count_corridors():
    """Which are of all craft, and one of craft 2 alone; the best order is another without them."""
    scenario = valid("rings", 3, 7)
    ends = np.concatenate([scenario.initial, scenario.goal])[:, :3]
    low, high = (tuple(one.tolist()) for one in (ends.min(axis=0) - 20, ends.max(axis=0) + 20))
    duration = Problem().duration
    near = Box(*(tuple((scenario.goal[0, :3] + side).tolist()) for side in (-60.0, 60.0)))
    tight = replace(
        scenario,
        corridors=(Corridor(Box(low, high), 0.0, duration), Corridor(near, 900.0, duration, (2,))),
    )
    (plan,) = GoalAssignment(Expert()).plan([tight])
    cost = inside_by_pair(tight)
    orders = list(permutations(range(3)))
    least = [cost[range(3), order].sum() for order in orders]
    fields = plan_document(plan)
    assert plan.status == SOLVED and judge_plan(fields["scenario"], fields).wrong == ()
    assert plan.assignment.slots == orders[np.argmin(least)]
    assert plan.certificate.fuel_lower_bound == pytest.approx(min(least), rel=1e-4)
    free = decoupled_costs(scenario)
    assert free.of(orders[np.argmin(least)]) < 0.98 * min(least)
    assert orders[np.argmin(least)] != next(ranked(free.fuel))


def test_where_no_order_keeps_all_inside_between_the_ends_there_is_proven_to_be_no_plan():
    begin = np.array([[0.0, -45, 0, 0.2, 0, 0], [0.0, 45, 0, 0.2, 0, 0]])
    goal = np.array([[0.0, 50, 0, 0, 0, 0], [0.0, -50, 0, 0, 0, 0]])
    for edge, status in ((2.0, INFEASIBLE), (60.0, SOLVED)):
        box = Corridor(Box((-60.0, -60.0, -60.0), (edge, 60.0, 60.0)), 0.0, 1200.0)
        asked = Scenario(Problem(), begin, goal, ends="any", corridors=(box,))
        assert np.isfinite(inside_by_pair(asked)).all() == (status == SOLVED)
        (plan,) = GoalAssignment(Expert()).plan([asked])
        assert plan.status == status, plan.message
        if status == INFEASIBLE:
            reason = "some craft cannot reach its own inside its corridors with any thrust"
            assert f"whichever goals they take, {reason}" in plan.message
