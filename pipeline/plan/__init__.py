"""Plans: states and controls of each craft, with a certificate that anyone can check."""

from pipeline.plan.certificate import (
    Certificate,
    Clearance,
    CorridorMargin,
    PassiveSafety,
    Risk,
    certify,
    gap_of,
)
from pipeline.plan.judge import (
    Draft,
    certified_plan,
    certified_plans,
    is_safe,
    violations,
    with_status,
)
from pipeline.plan.plan import (
    INFEASIBLE,
    SOLVED,
    UNSAFE,
    UNSOLVED,
    WITHOUT_GAP,
    Assignment,
    Plan,
    summary,
)
from pipeline.plan.recheck import Rechecked, recheck
from pipeline.plan.requirements import (
    AT_ALL_TIMES,
    Requirements,
    RiskLimit,
    SeparationKind,
    refuse_risk,
)

__all__ = [
    "AT_ALL_TIMES",
    "INFEASIBLE",
    "SOLVED",
    "UNSAFE",
    "UNSOLVED",
    "WITHOUT_GAP",
    "Assignment",
    "Certificate",
    "Clearance",
    "CorridorMargin",
    "Draft",
    "PassiveSafety",
    "Plan",
    "Rechecked",
    "Requirements",
    "Risk",
    "RiskLimit",
    "SeparationKind",
    "certified_plan",
    "certified_plans",
    "certify",
    "gap_of",
    "is_safe",
    "recheck",
    "refuse_risk",
    "summary",
    "violations",
    "with_status",
]
