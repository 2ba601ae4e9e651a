"""Plans: what each craft is to do, with a certificate that anyone can check."""

from pipeline.plan.certificate import (
    Certificate,
    Clearance,
    CorridorMargin,
    PassiveSafety,
    Risk,
    certify,
    gap_of,
)
from pipeline.plan.judge import Made, is_safe, judged, planned, planned_all, violations
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
    Separation,
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
    "Made",
    "PassiveSafety",
    "Plan",
    "Rechecked",
    "Requirements",
    "Risk",
    "RiskLimit",
    "Separation",
    "certify",
    "gap_of",
    "is_safe",
    "judged",
    "planned",
    "planned_all",
    "recheck",
    "refuse_risk",
    "summary",
    "violations",
]
