"""Plans: what each craft is to do, with a certificate that anyone can check."""

from pipeline.plan.assignment import Assignment
from pipeline.plan.certificate import Certificate, certify, gap_of
from pipeline.plan.passive_safety import PassiveSafety
from pipeline.plan.plan import INFEASIBLE, SOLVED, UNSAFE, UNSOLVED, Plan
from pipeline.plan.planned import Made, is_passively_safe, is_safe, planned, planned_all
from pipeline.plan.requirements import AT_ALL_TIMES, Requirements, Separation
from pipeline.plan.risk import Risk, RiskLimit
from pipeline.plan.summary import summary

__all__ = [
    "AT_ALL_TIMES",
    "INFEASIBLE",
    "SOLVED",
    "UNSAFE",
    "UNSOLVED",
    "Assignment",
    "Certificate",
    "Made",
    "PassiveSafety",
    "Plan",
    "Requirements",
    "Risk",
    "RiskLimit",
    "Separation",
    "certify",
    "gap_of",
    "is_passively_safe",
    "is_safe",
    "planned",
    "planned_all",
    "summary",
]
