"""A plan in a line: who made it, what it costs, how good it can be, who comes closest when."""

from dataclasses import asdict
from typing import Any

from pipeline.plan.plan import INFEASIBLE, Plan

CLAIMS = (
    "fuel",
    "delta_v",
    "craft_delta_v",
    "craft_delta_v_2norm",
    "fuel_lower_bound",
    "optimality_gap",
    "min_separation",
    "min_separation_pair",
    "min_separation_time",
    "min_separation_bound",
)
"""What of the certificate is in the line."""


def summary(plan: Plan) -> dict[str, Any]:
    """The line by field names, in SI units; ``seconds`` is the time that plan and proof took.

    Where it is proven that there is no plan, there is no optimum to be far from, so that
    ``optimality_gap`` is None.
    """
    claims = {name: getattr(plan.certificate, name) for name in CLAIMS}
    if plan.status == INFEASIBLE:
        claims["optimality_gap"] = None
    adrift = plan.certificate.passive_safety
    taken = plan.timing.get("plan", 0.0) + plan.timing.get("certificate", 0.0)
    risk = plan.certificate.risk
    return {
        "planner": plan.planner,
        "status": plan.status,
        "message": plan.message,
        **claims,
        "passive_safety": None if adrift is None else asdict(adrift),
        "seconds": taken,
        "risk": None if risk is None else asdict(risk),
        "assignment": None if plan.assignment is None else asdict(plan.assignment),
    }
