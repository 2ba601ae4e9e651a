"""Networks as planners: alone, as seeds of the expert, and with the expert as a fallback."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import isclose

import numpy as np

from pipeline.arrays import Array, Float
from pipeline.errors import InputError
from pipeline.expert import FIRST_SAFE, Settings, nominal_plans, within_risk
from pipeline.expert.batch import Batch
from pipeline.networks.document import TrainedNetwork
from pipeline.networks.recipes import REFINER
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.transfer import meet_goal, project_to_flyable
from pipeline.plan.plan import SOLVED, Plan
from pipeline.plan.requirements import AT_ALL_TIMES, Requirements
from pipeline.planners.classical import plans_from_controls
from pipeline.planners.planner import PlannerWrapper, requiring
from pipeline.scenario import Scenario, scenario_list

SAME = 1e-6  # relative difference up to which mean motions or time steps count as equal
# The expert limited to one round of convex programs, linearized about the network's plan
ONE_SOLVE = replace(FIRST_SAFE, max_rounds=1, margin=0.3, cut_spread=0.3, passive_safety_starts=0)


@dataclass(frozen=True, eq=False)
class NetworkPlanner:
    """Plans by a network, made flyable: states are projected, controls corrected."""

    model: TrainedNetwork
    name: str  # what tables and plans call it
    requirements: Requirements = AT_ALL_TIMES  # what its plans are judged by

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario, in order; the scenarios share one problem and one n.

        On another orbit or time grid than that of its training the network is used with the same
        weights; the certificate shows how good that is. InputError where they do not fit the
        number of nodes, or the scenarios differ in n.
        """
        scenarios = scenario_list(scenarios)
        if len(sizes := {scenario.n for scenario in scenarios}) > 1:
            raise InputError(
                f"scenarios have {sorted(sizes)} craft; expected one size for a network: plan "
                "those of each size by themselves."
            )

        def answer(batch: Batch) -> Float[Array, "n _ 3"]:
            problem, model, shape = batch.problem, self.model, (len(scenarios), -1, 6)
            initial, goal = batch.initial.reshape(shape), batch.goal.reshape(shape)
            if _other_field(model, problem) is not None:
                model = model.on(problem)
            each = np.array([*map(_separation, scenarios)])
            parts = [np.flatnonzero(each == radius) for radius in np.unique(each)]
            answers = [model.answer(initial[k], goal[k], float(each[k[0]])) for k in parts]
            found = np.concatenate(answers)[np.concatenate(parts).argsort()]
            if model.answers == "states":
                controls = project_to_flyable(found, initial, goal, problem)
            else:
                controls = meet_goal(initial, found, goal, problem)
            return controls.reshape(-1, problem.intervals, 3)

        return plans_from_controls(self.name, scenarios, answer, self.requirements)


@dataclass(frozen=True)
class Seeded(PlannerWrapper):
    """The expert, seeded with the plans of another planner."""

    settings: Settings = field(default_factory=lambda: Settings(stop="first-safe"))  # of the expert

    @property
    def name(self) -> str:
        """Both planners."""
        return f"{self.planner.name} + expert"

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario, safe wherever the expert finds one."""
        scenarios, asked = scenario_list(scenarios), self.requirements
        seeds = self.planner.plan(scenarios)
        plans = nominal_plans(scenarios, [seed.controls for seed in seeds], self.settings, asked)
        for k, (seed, plan) in enumerate(zip(seeds, plans, strict=True)):
            stages = {f"seed_{stage}": seconds for stage, seconds in seed.timing.items()}
            total = seed.timing["plan"] + plan.timing["plan"]
            who = self.name if plan.convex_solves else plan.planner
            plans[k] = replace(plan, planner=who, timing={**stages, **plan.timing, "plan": total})
        return [within_risk(plan, asked, self.settings) for plan in plans]


@dataclass(frozen=True, eq=False)
class FallbackPlanner(PlannerWrapper):
    """A network, then one convex solve from it, then the expert, until a plan is proven safe."""

    settings: Settings = FIRST_SAFE  # of the expert, in the last step

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario, which names its planner, safe where the expert finds one."""
        asked = self.requirements
        plans = requiring(self.planner, asked.nominal).plan(scenarios)
        plans = _where_unsafe(plans, ONE_SOLVE, asked, f"{self.name} + one solve", seeded=True)
        plans = _where_unsafe(plans, self.settings, asked, "expert")
        return [within_risk(plan, asked, self.settings) for plan in plans]


def _where_unsafe(
    plans: list[Plan], settings: Settings, asked: Requirements, name: str, *, seeded: bool = False
) -> list[Plan]:
    """The plans, replaced by the expert's where not proven safe, with the time of both."""
    left = [k for k, plan in enumerate(plans) if plan.status != SOLVED]
    seeds = [plans[k].controls for k in left] if seeded else None
    tried = nominal_plans([plans[k].scenario for k in left], seeds, settings, asked)
    for k, plan in zip(left, tried, strict=True):
        before = plans[k]
        timing = {**plan.timing, "plan": before.timing["plan"] + plan.timing["plan"]}
        solves = before.convex_solves + plan.convex_solves
        # Where a craft has no decoupled optimum, the expert does not use the seed.
        who = name if plan.convex_solves else plan.planner
        plans[k] = replace(plan, planner=who, timing=timing, convex_solves=solves)
    return plans


def check_problem(model: TrainedNetwork, problem: Problem, where: str) -> None:
    """Refuse a problem of another orbit or time grid than the model's with an InputError.

    The message says ``where`` the problem is from. Collision radius and thrust limit may differ,
    and a refiner plans any problem.
    """
    if model.architecture != REFINER and (field := _other_field(model, problem)):
        there, known = (_written(getattr(one, field)) for one in (problem, model.problem))
        raise InputError(
            f"{where} has {field} {there} and the network {model.architecture} was trained with "
            f"{known}; expected the same: take data of this kind or other models."
        )


def _written(value: float | int | ReferenceOrbit | None) -> str:
    return f"{value:.9g}" if isinstance(value, int | float) else str(value or "a circle")


def _separation(scenario: Scenario) -> float:
    """Separation for a network, m: the sum of the two largest radii, but at most r_col."""
    radius = scenario.problem.collision_radius
    return min(radius, float(np.sort(scenario.radii)[-2:].sum())) if scenario.n > 1 else radius


def _other_field(model: TrainedNetwork, problem: Problem) -> str | None:
    """The first field by which a problem differs from the training's; None where none does."""
    for name in ("nodes", "time_step", "mean_motion"):
        if not isclose(getattr(problem, name), getattr(model.problem, name), rel_tol=SAME):
            return name
    return None if problem.orbit == model.problem.orbit else "orbit"
