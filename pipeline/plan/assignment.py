"""Who takes which goal, where it does not matter which craft is where in the end."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Assignment:
    """What became of the goals of a scenario whose craft are interchangeable.

    The plan is for the scenario with its goals in the order of ``slots``; its certificate's lower
    bound on the fuel holds for every order.

    Attributes:
        slots: of each craft, the row of the scenario's given goals that it takes.
        rank: its place among all assignments by their decoupled cost, from 1; None where the
            given order was taken without being among those looked at.
        tried: assignments that were planned.
        given_fuel_lower_bound: what any plan for the given order burns at least, m/s²; None where
            it is proven that some craft cannot reach its given goal within the thrust limit.
        saving: share of that fuel which the plan saves, so at least as much against any plan for
            the given order; None where there is no such bound or no plan to fly.
    """

    slots: tuple[int, ...]
    rank: int | None
    tried: int
    given_fuel_lower_bound: float | None
    saving: float | None
