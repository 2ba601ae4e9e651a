"""Whether a plan does what it is meant to, and whether what it says of itself is so."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from judge.adrift import Adrift, closest_adrift, distance_adrift
from judge.corridors import least_inside
from judge.fuel import Bound, least_fuel, least_fuel_inside, least_fuel_of_any_order
from judge.keep_out import Closest, least_clearance, pairs
from judge.motion import Case, after, fly
from judge.separation import closest_approaches, distance_at
from judge.thrusters import Thrusters

METRES, METRES_A_SECOND = 1e-5, 1e-8
"""Largest difference of a state from what it is meant to be; rounding alone is far less."""

ATTAINED = 2e-4
"""Largest difference in m of a claimed separation from the true one."""

SHARE = 1e-6
"""Relative difference of forces and fuels that counts as rounding."""


@dataclass(frozen=True)
class Report:
    """What a judge finds; m, m/s, m/s² and s.

    Attributes:
        fuel: Σ‖u‖₁ of the controls.
        delta_v: that times the time step.
        fuel_lower_bound: proven for any transfer between the same ends.
        node_collisions: pairs and nodes within the collision radius.
        pair_conflicts: pairs that come within it at any time.
        min_separation: least distance of any pair at any time; infinite without a pair.
        faults: what a plan must not do and this one does, in words.
        false_claims: what the plan says of itself that is not so, in words.
    """

    fuel: float
    delta_v: float
    fuel_lower_bound: float
    node_collisions: int
    pair_conflicts: int
    min_separation: float
    faults: tuple[str, ...]
    false_claims: tuple[str, ...]

    @property
    def wrong(self) -> tuple[str, ...]:
        """Everything that is: a plan to trust has nothing."""
        return self.faults + self.false_claims


@dataclass(frozen=True)
class _Flight:
    """What a plan's controls do, and what is found about it."""

    problem: Case
    goal: np.ndarray
    states: np.ndarray
    controls: np.ndarray
    low: float
    high: float
    node_collisions: int
    fuel: float
    most: float
    proven: float
    attained: float
    adrift: Adrift | None = None
    clear: Closest | None = None
    inside: float = np.inf
    least: np.ndarray | None = None


def judge_plan(
    scenario: Mapping[str, Any], plan: Mapping[str, Any], *, at_nodes: bool = False
) -> Report:
    """Judge a plan by its controls; its states and its certificate are claims like any other.

    Args:
        scenario: the fields of scenario.json.
        plan: ``states``, ``controls`` and, where they are there, ``times`` and ``certificate``.
            With an ``assignment`` its lower bound is claimed to hold for any order of the goals.
        at_nodes: ask for separation at the nodes only.
            A plan that claims passive safety is asked for it.

    Raises:
        ValueError: where the arrays are not of the scenario's size or not finite.
    """
    initial, goal = (np.asarray(scenario[end], dtype=float) for end in ("initial", "goal"))
    problem = Case.of(scenario, len(initial))
    states, controls = (np.asarray(plan[name], dtype=float) for name in ("states", "controls"))
    n, T = len(initial), problem.nodes
    if (states.shape, controls.shape) != ((n, T, 6), (n, T - 1, 3)):
        raise ValueError(f"states are {states.shape} and controls {controls.shape}")
    if not (np.isfinite(states).all() and np.isfinite(controls).all()):
        raise ValueError("states or controls are not finite")
    flown = fly(problem, initial, controls)
    near = closest_approaches(problem, flown, controls)
    at = [
        np.linalg.norm(flown[i, :, :3] - flown[j, :, :3], axis=1)
        for i, j in zip(near.first, near.second, strict=True)
    ]
    least = least_fuel_of_any_order if plan.get("assignment") else least_fuel
    bound: Bound = least(problem, initial, goal)
    said = plan.get("certificate", {})
    fuel = float(_spent(problem, controls).sum())
    most = float(bound.attained.sum())  # that a plan can be proven to need
    if scenario.get("corridors"):  # in the order of goals that is flown, of any that may be
        timed = all(one.get("time") is not None for one in scenario.get("waypoints", ()))
        told = timed and problem.thrusters is None
        inside = least_fuel_inside(scenario, problem, initial, goal) if told else fuel
        most = min(float(np.sum(inside)) * (1 + 1e-5), fuel)  # a bit more between those times
    if problem.thrusters is not None and problem.thrusters.bit_counts:
        most = max(most, fuel)  # what burns as large as the bit need is told by tests of these
    claim = said.get("passive_safety")
    adrift = None
    if claim is not None and n > 1:
        adrift = closest_adrift(problem, flown, controls, claim["orbits"])
    clear, close = None, int(np.sum(np.array(at) <= problem.radius))
    if said.get("clearance") or document_has_sizes(scenario):
        clear = least_clearance(scenario, problem, flown, controls)
        nodes = (*(problem.step * np.arange(problem.nodes)).tolist(),)
        each = [apart for *_, apart in pairs(scenario, problem, flown, controls)]
        close = sum(int((apart(nodes) <= 0).sum()) for apart in each)
    flight = _Flight(
        problem,
        goal,
        flown,
        controls,
        low=near.low.min(initial=np.inf),
        high=near.high.min(initial=np.inf),
        node_collisions=close,
        fuel=fuel,
        most=most,
        proven=float(bound.proven.sum()),
        attained=float(bound.attained.sum()),
        adrift=adrift,
        clear=clear,
        inside=least_inside(scenario, problem, flown, controls),
        least=bound.attained,
    )
    return Report(
        flight.fuel,
        flight.fuel * problem.step,
        flight.proven,
        flight.node_collisions,
        int((near.low <= problem.radius).sum()),
        float(flight.high),
        tuple(_faults(flight, at_nodes=at_nodes)),
        (
            *_untrue_states(flight, states, plan.get("times")),
            *_untrue(flight, states, said, plan.get("status", "solved")),
            *_untrue_adrift(flight, said),
            *_untrue_clearance(flight, said),
            *_untrue_of_thrusters(flight, said),
        ),
    )


def _faults(flight: _Flight, *, at_nodes: bool) -> Iterator[str]:
    problem = flight.problem
    miss = np.abs(flight.states[:, -1] - flight.goal).max(axis=0)
    if miss[:3].max() > METRES:
        yield f"misses the goal by {miss[:3].max():.3g} m"
    if miss[3:].max() > METRES_A_SECOND:
        yield f"misses the goal's velocity by {miss[3:].max():.3g} m/s"
    used = np.abs(flight.controls).max()
    if problem.thrusters is not None:
        yield from problem.thrusters.faults(flight.controls, problem.step)
    elif problem.limit is not None and used > problem.limit * (1 + SHARE):
        yield f"uses {used:.6g} m/s² of {problem.limit:.6g} m/s²"
    yield from _too_close(flight, at_nodes=at_nodes)
    if flight.fuel < flight.proven * (1 - SHARE):
        yield f"burns {flight.fuel:.6g} m/s² where none burns less than {flight.proven:.6g}"


def _too_close(flight: _Flight, *, at_nodes: bool) -> Iterator[str]:
    problem = flight.problem
    if flight.node_collisions:
        near = "too close by size" if flight.clear else f"within {problem.radius:g} m"
        yield f"comes {near} at a node"
    elif flight.clear is not None:
        if not at_nodes and flight.clear.clearance <= 0:
            yield f"craft {flight.clear.craft} comes too close to {flight.clear.other}"
    elif not at_nodes and flight.low <= problem.radius:
        yield f"comes as close as {flight.high:.6g} m between nodes"
    if flight.inside <= 0:
        yield f"leaves a corridor by {-flight.inside:.6g} m"
    if flight.adrift is not None and flight.adrift.distance <= problem.radius:
        lost = flight.adrift
        yield (
            f"craft {lost.lost}, adrift from node {lost.node}, comes as close as "
            f"{lost.distance:.6g} m to craft {lost.other}"
        )


def document_has_sizes(scenario: Mapping[str, Any]) -> bool:
    """Whether craft have radii of their own, or there are obstacles."""
    radii = any(one.get("radius") for one in scenario.get("craft", []))
    return radii or bool(scenario.get("obstacles"))


def _untrue_clearance(flight: _Flight, said: Mapping[str, Any]) -> Iterator[str]:
    """False claims about the least clearance and the margin inside corridors.

    About an ellipsoid or in a cone the claim may be less than is true.
    """
    inside = said.get("corridor") or {}
    for name, value in inside.items():
        if name.startswith("min_margin") and value > flight.inside + ATTAINED:
            yield f"{name} is {value} where it is {flight.inside}"
    claim, clear = said.get("clearance"), flight.clear
    if claim is None or clear is None:
        return
    for name in ("min_clearance", "min_clearance_bound"):
        if claim[name] > clear.clearance + ATTAINED:
            yield f"{name} is {claim[name]} where it is {clear.clearance}"


def _untrue_states(flight: _Flight, states: np.ndarray, times: list[float] | None) -> Iterator[str]:
    off = np.abs(states - flight.states).max(axis=(0, 1))
    if off[:3].max() > METRES or off[3:].max() > METRES_A_SECOND:
        yield f"states are {off[:3].max():.3g} m, {off[3:].max():.3g} m/s from what is flown"
    grid = flight.problem.step * np.arange(flight.problem.nodes)
    if times is not None and not np.allclose(times, grid, rtol=1e-12):
        yield "times are not those of the nodes"


def _untrue(
    flight: _Flight, states: np.ndarray, said: Mapping[str, Any], status: str
) -> Iterator[str]:
    """Claims of a certificate, of which any may be left out, against what is found."""
    problem, alone = flight.problem, len(flight.goal) == 1
    moved = after(problem.rate, problem.step, states[:, :-1], flight.controls)
    bounds = (flight.most, flight.attained)
    gaps = [flight.fuel / one - 1 for one in bounds if one > 1e-9]
    no_plan = status in ("unsolved", "infeasible")  # which has no gap
    exact = 1e-9 if problem.thrusters is None else 1e-7  # a program may say what thrusters do
    # By name: least and most that is true.
    true = {
        "fuel": _about(flight.fuel, exact),
        "delta_v": _about(flight.fuel * problem.step, exact),
        "fuel_lower_bound": (_about(flight.attained, SHARE)[0], _about(flight.most, SHARE)[1]),
        "optimality_gap": bool(gaps) and not no_plan and (min(gaps) - 2e-6, max(gaps) + 2e-6),
        # About an ellipsoid and a craft of some radius more may be counted.
        "node_collisions": (
            flight.node_collisions,
            flight.node_collisions if flight.clear is None else np.inf,
        ),
        "min_separation": not alone and (flight.low - ATTAINED, flight.high + ATTAINED),
        "min_separation_bound": not alone and (-np.inf, flight.high),
        "goal_error": _near(np.abs(states[:, -1] - flight.goal)[:, :3].max()),
        "dynamics_error": _near(np.abs(states[:, 1:] - moved)[..., :3].max()),
    }
    for name in true.keys() & said.keys():
        claim, range_ = said[name], true[name]
        if range_ is False:  # nothing to be claimed
            if claim is not None and (no_plan or name != "optimality_gap"):
                yield f"{name} is said to be {claim} where there is none"
        elif claim is None or not range_[0] <= claim <= range_[1]:
            yield f"{name} is said to be {claim}, found {range_[0]:.9g} to {range_[1]:.9g}"
    for name, order in (("craft_delta_v", 1), ("craft_delta_v_2norm", 2)):
        spent = problem.step * np.linalg.norm(flight.controls, ord=order, axis=2).sum(axis=1)
        if name in said and not (
            len(said[name]) == len(spent) and np.allclose(said[name], spent, rtol=1e-9, atol=1e-12)
        ):
            yield f"{name} is not what the controls spend"
    pair, time = said.get("min_separation_pair"), said.get("min_separation_time")
    if pair is not None and time is not None:
        found = distance_at(problem, flight.states, flight.controls, tuple(pair), time)
        if abs(found - said["min_separation"]) > ATTAINED:
            yield f"craft {pair[0]} and {pair[1]} are {found:.6g} m apart at {time:.6g} s"


def _untrue_adrift(flight: _Flight, said: Mapping[str, Any]) -> Iterator[str]:
    """What a certificate says of losses of thrust, against what is found."""
    claim, found = said.get("passive_safety"), flight.adrift
    if claim is None or found is None:
        return
    if abs(claim["min_separation"] - found.distance) > ATTAINED:
        yield f"adrift, {claim['min_separation']} m are said to be least, found {found.distance}"
    if claim["min_separation_bound"] > found.distance + METRES:
        yield f"adrift, {claim['min_separation_bound']} m are said to be proven"
    who = tuple(claim["pair"]), claim["node"], claim["time"]
    apart = distance_adrift(flight.problem, flight.states, flight.controls, *who)
    since = claim["time"] - claim["node"] * flight.problem.step
    longest = claim["orbits"] * 2 * np.pi / flight.problem.rate
    if abs(apart - claim["min_separation"]) > ATTAINED or not -1e-6 <= since <= longest + 1e-6:
        yield f"{who} are {apart:.6g} m apart, {since:.6g} s after the loss"


def _spent(problem: Case, controls: np.ndarray) -> np.ndarray:
    """Fuel of each craft, m/s²."""
    if problem.thrusters is None:
        return np.asarray(np.abs(controls).sum(axis=(1, 2)))
    return problem.thrusters.spent(controls)


def _untrue_of_thrusters(flight: _Flight, said: Mapping[str, Any]) -> Iterator[str]:
    """What a certificate says of shares, of the smallest burn and of thrusters."""
    thrusters, step = flight.problem.thrusters, flight.problem.step
    given = thrusters is not None and not isinstance(thrusters.model, str)
    asked = {
        "largest_share": thrusters is not None and thrusters.fair,
        "smallest_burn": thrusters is not None and thrusters.bit > 0,
        "craft_delta_v_thrusters": given,
    }
    yield from (
        f"{name} is said, or is not" for name in asked if asked[name] != bool(said.get(name))
    )
    if thrusters is None:
        return
    fired = thrusters.firings(flight.controls)
    spent = step * fired.sum(axis=(1, 2))
    claim = said.get("craft_delta_v_thrusters") or ()
    if given and not np.allclose(claim, spent, rtol=SHARE):
        yield f"thrusters are said to spend {claim}, found {spent}"
    if share := said.get("largest_share"):
        assert flight.least is not None
        shares, least = spent / thrusters.budget, (step * flight.least / thrusters.budget).max()
        if abs(shares[share["craft"]] - shares.max()) > SHARE * shares.max():
            yield f"craft {share['craft']} is said to burn the largest share of {shares}"
        if abs(share["share"] - shares.max()) > SHARE * shares.max():
            yield f"{share['share']} is said to be the largest of {shares}"
        most = shares.max() if thrusters.bit_counts else least
        if not _about(least, SHARE)[0] <= share["bound"] <= _about(max(most, least), SHARE)[1]:
            yield f"no share is said to be less than {share['bound']}, found {least} to {most}"
    if smallest := said.get("smallest_burn"):
        yield from _untrue_of_burns(smallest, flight.controls, thrusters, step)


def _untrue_of_burns(
    said: Mapping[str, Any], controls: np.ndarray, thrusters: Thrusters, step: float
) -> Iterator[str]:
    """What a certificate says of the smallest burn: of several firings it may mean others."""
    fired, claim = thrusters.firings(controls), said["least"]
    burns = fired[fired > 1e-6 * fired.max(axis=2, keepdims=True)]
    least = step * burns.min() if len(burns) else None
    if said["asked"] != thrusters.bit:
        yield f"{said['asked']} is said to be asked for, not {thrusters.bit}"
    if least is None or claim is None:
        possible = least is claim
    else:
        possible = abs(least - claim) <= SHARE * least or (
            claim > least and not thrusters.smaller(controls, claim / step).any()
        )
    if not possible:
        yield f"the smallest burn is said to be {claim}, found {least}"


def _about(value: float, share: float) -> tuple[float, float]:
    return value * (1 - share) - 1e-12, value * (1 + share) + 1e-12


def _near(value: float) -> tuple[float, float]:
    return value - METRES, value + METRES
