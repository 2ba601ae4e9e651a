"""A planner whose plans must not be riskier than asked when craft err: the expert widens them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from pipeline.errors import InputError
from pipeline.expert import Settings, within_risk
from pipeline.plan import Plan, RiskLimit
from pipeline.planners.named import Separation
from pipeline.planners.planner import Planner
from pipeline.scenario import Scenario


@runtime_checkable
class EndsInExpert(Planner, Protocol):
    """A planner that leaves to the expert what it cannot make safe."""

    @property
    def settings(self) -> Settings:
        """Of the expert."""
        ...


@dataclass(frozen=True)
class WithinRisk:
    """Another planner's plans, and the expert's with wider separation where they are too risky.

    Attributes:
        planner: who plans for the collision radius alone.
        limit: the risk, and the errors.
    """

    planner: EndsInExpert
    limit: RiskLimit

    @property
    def name(self) -> str:
        """The planner's; its plans say where the expert came after it."""
        return self.planner.name

    def plan(self, scenarios: Sequence[Scenario]) -> list[Plan]:
        """One plan for each scenario, with the risk in its certificate."""
        plans = self.planner.plan(scenarios)
        return [
            within_risk(scenario, plan, self.limit, self.planner.settings)
            for scenario, plan in zip(scenarios, plans, strict=True)
        ]


def with_risk(planner: Planner, limit: RiskLimit, separation: Separation) -> WithinRisk:
    """The planner, held to a risk.

    Args:
        planner: that ends in the expert.
        limit: the risk, and the errors.
        separation: that was asked for.

    Raises:
        InputError: where no expert comes after it, or craft are kept apart at the nodes alone.
    """
    if not isinstance(planner, EndsInExpert):
        raise InputError(
            f"--risk is given and the expert has no part in plans of {planner.name}; expected it "
            "with the expert, or with a model and without --raw: leave --risk and its sigmas out."
        )
    if separation == "nodes":
        raise InputError(
            "--risk is given and --separation is nodes; expected continuous, since a risk is that "
            "of all times: leave --separation out."
        )
    return WithinRisk(planner, limit)
