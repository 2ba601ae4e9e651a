"""Ways to fly a plan: open loop, with feedback, replanned at every node, and with a margin.

The margin is a back-off: a number of standard deviations, under feedback, of each pair's separation
at each time is kept beyond r_col, as room for errors.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.errors import InputError, check_whole
from pipeline.expert import BackOff, Trajectory, with_back_off
from pipeline.flight import FEEDBACK, MARGIN, OPEN, REPLANNED
from pipeline.flight.closed_loop import ClosedLoop, asked_with_margin, without_craft
from pipeline.flight.effects import refuse_distance
from pipeline.flight.errors import Errors, check_seed, draws, lost_thrust
from pipeline.flight.trials import Trials, feedback, fly_trials, open_loop
from pipeline.flight.world import LinearWorld, World
from pipeline.orbit.arrays import Controls, States
from pipeline.orbit.partition import MOST_PAIRS, swarm_partition
from pipeline.plan.plan import SOLVED, Plan
from pipeline.plan.requirements import Requirements
from pipeline.planners.planner import Planner
from pipeline.scenario import Scenario

PORTION = 50  # largest number of trials in a batch
ON_GPU = 10  # times as many on a GPU, to keep it busy
MOST_TRIALS = 10_000_000  # of one Monte Carlo
SIGMAS = 3.0  # default margin, in standard deviations of a separation
MOST_SIGMAS = 10.0  # largest margin, in the same
DEAR = 2.0  # largest fuel with a margin, in that of the plan


@dataclass(frozen=True, eq=False)
class Loop:
    """A way to fly a plan's controls, m/s²."""

    name: str
    controls: Controls
    states: States | None = None  # reference of the feedback, m and m/s; None without feedback
    planner: Planner | None = None  # replans at every node; None without replanning
    back_off: BackOff | None = None  # kept beyond the collision radius when replanning


def flight_loops(
    plan: Plan,
    errors: Errors,
    planner: Planner | None = None,
    sigmas: float = SIGMAS,
    *,
    with_feedback: bool = False,
) -> Iterator[Loop]:
    """The loops of a plan: open, on request feedback, and with a planner replanned and with margin.

    The last one keeps ``sigmas`` standard deviations of ``errors`` beyond the collision radius.
    InputError where the controls lead too far away, or corrections and planning anew cannot keep
    what the plan keeps; and, where a craft may lose its thrust, for one that is alone, sizes or
    corridors, or a planner that cannot plan for the others.
    """
    scenario = plan.scenario
    refuse_distance(scenario, plan.controls)
    if planner is not None or with_feedback:
        _refuse_replanning(plan, with_feedback=with_feedback)
    if errors.lost > 0:
        if scenario.n == 1:
            raise InputError(
                f"lost is {errors.lost:g} and there is one craft; expected 0, or craft that fly on."
            )
        if scenario.unlike:
            raise InputError(
                f"lost is {errors.lost:g} and craft have radii of their own, or there are "
                "obstacles or corridors, past which no drift of a lost craft is flown; expected 0."
            )
        if planner is not None:
            planner.plan([without_craft(scenario, 0)])
    yield Loop(OPEN, plan.controls)
    if with_feedback:
        yield Loop(FEEDBACK, plan.controls, plan.states)
    if planner is None:
        return
    yield Loop(REPLANNED, plan.controls, planner=planner)
    expected = errors.gaussian(scenario.problem.time_step)
    back_off = BackOff(expected, sigmas, closed_loop=True)
    wider = _with_margin(plan, back_off, planner.requirements, errors)
    yield Loop(MARGIN, wider, planner=planner, back_off=back_off)


def batch_size(n: int, world: World, loop: Loop) -> int:
    """Number of trials of n craft in a batch, whose pairs must fit in memory."""
    on_gpu = isinstance(world, LinearWorld) and (world.device or "").startswith("cuda")
    times = ON_GPU if on_gpu and loop.planner is None else 1  # plans are made by the CPU
    return max(1, min(times * PORTION, times * 2 * MOST_PAIRS // n**2))


@dataclass(frozen=True, eq=False)
class TrialSettings:
    """What decides, with the loop, the trials of a Monte Carlo, and the size of its portions."""

    scenario: Scenario
    world: World
    errors: Errors
    seed: int = 0
    portion: int | None = None  # trials flown and kept together; None for those of a batch

    def __post_init__(self) -> None:
        check_seed(self.seed)

    def portion_of(self, loop: Loop) -> int:
        """Number of trials in each portion of a loop but the last."""
        return self.portion or batch_size(self.scenario.n, self.world, loop)

    def portions(self, loop: Loop, trials: int) -> list[range]:
        """The trials of a loop, portion by portion; InputError for none, or too many."""
        check_whole("trials", trials, 1, MOST_TRIALS)
        step = self.portion_of(loop)
        return [range(k, min(k + step, trials)) for k in range(0, trials, step)]

    def fly(self, loop: Loop, trials: range) -> Trials:
        """Fly Monte Carlo trials of one guidance loop as a batch, as in ``fly_trials``."""
        scenario, errors, count = self.scenario, self.errors, len(trials)
        drawn = draws(self.seed, trials, scenario.n, scenario.problem.intervals)
        unsafe, seconds = np.zeros(count, dtype=int), np.zeros((count, 0))
        guidance = open_loop(loop.controls)
        if loop.planner is not None:
            loss = lost_thrust(drawn, errors, scenario.problem)
            closed = ClosedLoop(scenario, loop.controls, loop.planner, loss, errors, loop.back_off)
            guidance, unsafe, seconds = closed, closed.unsafe, closed.seconds  # filled in flight
        elif loop.states is not None:
            late = bool(errors.latency)
            guidance = feedback(loop.controls, loop.states, scenario.problem, late=late)
        flown = fly_trials(scenario, self.world, guidance, drawn, errors)
        replanning = {"unsafe_replans": unsafe, "replan_seconds": seconds}
        return {"trial": np.array(trials), **flown, **replanning}


def fly_loops(of: TrialSettings, loops: Sequence[Loop], trials: int) -> dict[str, Trials]:
    """Trials of each loop by its name, all kept in memory; InputError as ``portions``."""
    found: dict[str, Trials] = {}
    for loop in loops:
        flown = [of.fly(loop, part) for part in of.portions(loop, trials)]
        found[loop.name] = {name: np.concatenate([p[name] for p in flown]) for name in flown[0]}
    return found


def _refuse_replanning(plan: Plan, *, with_feedback: bool) -> None:
    """Raise InputError for sizes, limits of thrust or a risk that replanning cannot keep."""
    if plan.scenario.unlike:
        raise InputError(
            "craft have radii of their own, or there are obstacles or corridors, which guidance "
            "that plans anew does not know; expected no replanning with these: fly in open loop."
        )
    if plan.scenario.limits is not None:
        raise InputError(
            "the scenario says more of thrust than max_acceleration, or has waypoints, which "
            "guidance that plans anew does not know; expected no replanning, or a scenario without "
            "thrust, max_acceleration_norm, min_delta_v, no_burn, objective, limits of its craft "
            "and waypoints."
        )
    if (risk := plan.certificate.risk) is None or with_feedback:
        return
    how, instead = "in open loop", "no replanning, or a plan without a risk"
    if risk.feedback is not None:
        how, instead = "with feedback", "feedback as replan"
    raise InputError(
        f"the plan was asked for a risk of at most {risk.asked:g} {how}, which planning anew does "
        f"not keep; expected {instead}."
    )


def _with_margin(
    plan: Plan, back_off: BackOff, requirements: Requirements, errors: Errors
) -> Controls:
    """Controls that keep as much of a back-off as possible from the first node on, m/s².

    Those of the plan where no safe ones are found, or they cost too much.
    """
    problem, alone = plan.scenario.problem, swarm_partition((plan.scenario.n,))
    for required in asked_with_margin(requirements, problem, errors):
        (wider,) = with_back_off([plan], back_off, required)
        dear = wider.certificate.fuel > DEAR * plan.certificate.fuel
        flown = Trajectory(wider.controls, wider.states)
        short = back_off.shortfall(flown, problem, required, alone)[0]
        if wider.status == SOLVED and not dear and (short == 0 or required == requirements):
            return wider.controls
    return plan.controls
