"""Ways to fly a plan: open loop, replanned at every node, and replanned with a margin.

The margin is separation asked for beyond r_col, so that errors use it up before craft are at risk.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.errors import InputError, check_range
from pipeline.flight.closed_loop import ClosedLoop, apart_at
from pipeline.flight.errors import Errors, check_seed, draws
from pipeline.flight.trials import Trials, fly_trials, open_loop
from pipeline.flight.world import World
from pipeline.orbit.approaches import MOST_PAIRS, TOLERANCE
from pipeline.orbit.arrays import Controls
from pipeline.orbit.bezier import norm
from pipeline.orbit.problem import Problem
from pipeline.plan import SOLVED, Plan
from pipeline.planners.planner import Planner
from pipeline.scenario import Scenario

OPEN, REPLANNED, MARGIN = "open loop", "replanned", "with margin"  # names of the loops
PORTION = 50  # most trials that are flown side by side
MOST_TRIALS = 10_000_000  # of one Monte Carlo
SIGMAS = 3.0  # standard deviations of a relative position that the default margin covers

# Shares of a margin that are tried in turn at the first node, until there is a safe plan
MARGIN_SHARES = (1.0, 0.75, 0.5, 0.25, 0.1)


@dataclass(frozen=True, eq=False)
class Loop:
    """A way to fly a plan's controls, m/s²: in open loop, or with a planner that replans.

    A margin, m, is asked for beyond the collision radius when replanning.
    """

    name: str
    controls: Controls
    planner: Planner | None = None
    margin: float = 0.0

    def fly(
        self, scenario: Scenario, world: World, errors: Errors, trials: range, seed: int
    ) -> Trials:
        """Fly some trials side by side, as in ``fly_trials``."""
        drawn = draws(seed, trials, scenario.n, scenario.problem.intervals)
        if self.planner is None:
            flown = fly_trials(scenario, world, open_loop(self.controls), drawn, errors)
            unsafe, seconds = np.zeros(len(trials), dtype=int), np.zeros((len(trials), 0))
        else:
            closed = ClosedLoop(scenario, self.controls, self.planner, len(trials), self.margin)
            flown = fly_trials(scenario, world, closed, drawn, errors)
            unsafe, seconds = closed.unsafe, closed.seconds
        replanning = {"unsafe_replans": unsafe, "replan_seconds": seconds}
        return {"trial": np.array(trials), **flown, **replanning}


def flight_loops(
    scenario: Scenario,
    controls: Controls,
    errors: Errors,
    planner: Planner | None = None,
    margin: float | None = None,
) -> Iterator[Loop]:
    """The open loop of a plan's controls, m/s², and with a planner two closed loops.

    The last one asks for a margin, m, as far as there is room; by default the one for ``errors``.
    """
    yield Loop(OPEN, controls)
    if planner is None:
        return
    yield Loop(REPLANNED, controls, planner)
    wanted = default_margin(errors, controls, scenario.problem) if margin is None else margin
    wider, allowed = with_margin(scenario, controls, planner, wanted)
    yield Loop(MARGIN, wider, planner, allowed)


def portion_of(n: int) -> int:
    """Trials of n craft that are flown side by side: so few that their pairs fit in memory."""
    return max(1, min(PORTION, 2 * MOST_PAIRS // n**2))


def fly_loops(
    scenario: Scenario,
    world: World,
    errors: Errors,
    loops: Sequence[Loop],
    trials: int,
    seed: int = 0,
) -> dict[str, Trials]:
    """Fly each loop so many times, by the loop's name; all trials are in memory.

    Raises:
        InputError: for no trials, more than MOST_TRIALS, or a seed that is none.
    """
    check_range("trials", trials, 1, MOST_TRIALS)
    check_seed(seed)
    portion = portion_of(scenario.n)
    parts = [range(k, min(k + portion, trials)) for k in range(0, trials, portion)]
    found: dict[str, Trials] = {}
    for loop in loops:
        flown = [loop.fly(scenario, world, errors, part, seed) for part in parts]
        found[loop.name] = {name: np.concatenate([p[name] for p in flown]) for name in flown[0]}
    return found


def refuse_replanning(plan: Plan) -> None:
    """Refuse to plan anew for a risk, which is one of open loop, or what guidance does not know.

    Raises:
        InputError: where the plan was asked for one, or has limits of thrust or sizes of its own.
    """
    if plan.scenario.unlike:
        raise InputError(
            "craft have radii of their own, or there are obstacles or corridors, which guidance "
            "that plans anew does not know; expected no replanning with these: fly in open loop."
        )
    if plan.scenario.limits is not None:
        raise InputError(
            "the scenario says more of thrust than max_acceleration, which guidance that plans "
            "anew does not know; expected no replanning, or a scenario without thrust, "
            "max_acceleration_norm, min_delta_v, no_burn, objective, limits of its craft and "
            "waypoints."
        )
    if (risk := plan.certificate.risk) is not None:
        raise InputError(
            f"the plan was asked for a risk of at most {risk.asked:g} in open loop, which planning "
            "anew does not keep; expected no replanning, or a plan without a risk: a margin is "
            "what keeps craft apart from their errors then."
        )


def default_margin(errors: Errors, controls: Controls, problem: Problem) -> float:
    """Three standard deviations of a relative position one interval ahead, m.

    To these, two craft's navigation errors grow, and the errors of the largest burn of the controls
    (m/s²) lead meanwhile, along the worst direction in the worst interval. Fixed errors of burns
    count with it.
    """
    h, burn = problem.time_step, float(norm(controls).max())
    A, B = (one[..., :3, :] for one in problem.dynamics.step(h, np.arange(problem.intervals)))
    position = errors.position**2 + errors.position_bias**2
    velocity = errors.velocity**2 + errors.velocity_bias**2
    share = max(errors.magnitude, errors.direction)
    fixed = max(errors.magnitude_fixed, errors.direction_fixed)
    thrust = (share * burn) ** 2 + (fixed / h) ** 2 * (burn > 0)
    late = (errors.timing * burn) ** 2
    covariance = A @ np.diag(np.repeat([position, velocity], 3)) @ A.mT
    covariance += thrust * B @ B.mT + late * A[..., 3:] @ A[..., 3:].mT
    return SIGMAS * float(np.sqrt(2 * np.linalg.eigvalsh(covariance).max()))


def with_margin(
    scenario: Scenario, controls: Controls, planner: Planner, margin: float
) -> tuple[Controls, float]:
    """Controls with more separation than r_col, m/s², and how much more, m.

    As much of the margin as both formations leave room for, or the largest share of that with
    which the planner finds a safe plan; where there is none, the controls that are given.
    """
    radius = scenario.problem.collision_radius
    room = min(float(apart_at(end[None])[0]) for end in (scenario.initial, scenario.goal)) - radius
    most = min(margin, room - 2 * TOLERANCE)
    for share in MARGIN_SHARES if most > 0 else ():
        wider = replace(scenario.problem, collision_radius=radius + share * most)
        (plan,) = planner.plan([replace(scenario, problem=wider)])
        if plan.status == SOLVED:
            return plan.controls, share * most
    return controls, 0.0
