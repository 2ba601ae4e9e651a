"""Planners without a network: the expert, and baselines that plan each craft without the others."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from pipeline.expert import Settings, solve_many
from pipeline.expert.batch import Batch, in_batches
from pipeline.orbit.arrays import Controls
from pipeline.orbit.transfer import minimum_energy, project_to_flyable, straight_line
from pipeline.plan.judge import Draft, certified_plans
from pipeline.plan.plan import INFEASIBLE, Plan
from pipeline.plan.requirements import AT_ALL_TIMES, Requirements
from pipeline.scenario import Scenario, scenario_list


@dataclass(frozen=True)
class Expert:
    """Sequential convex programming on all scenarios at once."""

    settings: Settings = field(default_factory=Settings)
    name: str = "expert"  # what tables call it
    requirements: Requirements = AT_ALL_TIMES  # what its plans must satisfy

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario."""
        asked = scenario_list(scenarios)
        plans = solve_many(asked, settings=self.settings, requirements=self.requirements)
        return [replace(plan, planner=self.name) for plan in plans]


@dataclass(frozen=True)
class Baseline:
    """A planner that ignores collisions: each craft is planned without the others."""

    name: str  # what tables call it
    controls: Callable[[Batch], Controls]  # gives controls that meet the goals, m/s²
    requirements: Requirements = AT_ALL_TIMES  # what its plans are judged by

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario, which does not depend on the others."""
        asked = scenario_list(scenarios)

        def planned(some: Sequence[int]) -> list[Plan]:
            part = [asked[k] for k in some]
            return plans_from_controls(self.name, part, self.controls, self.requirements)

        return in_batches(asked, planned)


def _straight_line(batch: Batch) -> Controls:
    states = straight_line(batch.initial, batch.goal, batch.problem.nodes)
    return project_to_flyable(states, batch.initial, batch.goal, batch.problem)


def _minimum_energy(batch: Batch) -> Controls:
    return minimum_energy(batch.initial, batch.goal, batch.problem)


def _decoupled(batch: Batch) -> Controls:
    return batch.optima.controls


# Baselines of every table
BASELINES = (
    Baseline("straight line", _straight_line),
    Baseline("minimum energy", _minimum_energy),
    Baseline("decoupled optimum", _decoupled),
)


def plans_from_controls(
    planner: str,
    scenarios: Sequence[Scenario],
    answer: Callable[[Batch], Controls],
    requirements: Requirements,
) -> list[Plan]:
    """Plans of the controls, m/s², that ``answer`` gives; INFEASIBLE where provably none exists.

    The controls are those of the craft of all scenarios, one after the other, and meet the goals.
    """
    if not scenarios:
        return []
    started, batch = time.perf_counter(), Batch(scenarios)
    controls = answer(batch)
    timing = {"plan": (time.perf_counter() - started) / len(scenarios)}
    drafts = [
        Draft(controls[craft], *batch.bound(k), timing=timing, least_share=batch.least_share(k))
        for k, craft in enumerate(batch.craft)
    ]
    plans = certified_plans(planner, scenarios, drafts, requirements)
    return [
        replace(plan, status=INFEASIBLE, message=why) if why else plan
        for plan, why in zip(plans, batch.infeasible(), strict=True)
    ]
