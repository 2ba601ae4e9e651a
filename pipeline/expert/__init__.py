"""The expert: sequential convex programming (SCP) with half-space collision constraints."""

from pipeline.expert.expert import nominal_plans
from pipeline.expert.own import own_optima
from pipeline.expert.planning import solve, solve_many
from pipeline.expert.risk import all_within_risk, within_risk
from pipeline.expert.seeds import SEEDS
from pipeline.expert.settings import BEST, EFFORTS, FIRST_SAFE, Settings

__all__ = [
    "BEST",
    "EFFORTS",
    "FIRST_SAFE",
    "SEEDS",
    "Settings",
    "all_within_risk",
    "nominal_plans",
    "own_optima",
    "solve",
    "solve_many",
    "within_risk",
]
