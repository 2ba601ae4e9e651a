"""The expert: sequential convex programming (SCP) with half-space collision constraints."""

from pipeline.expert.conflicts import BackOff, Trajectory
from pipeline.expert.decoupled import decoupled_optima
from pipeline.expert.expert import solve, solve_many, within_risk
from pipeline.expert.nominal import nominal_plans, with_back_off
from pipeline.expert.seeds import SEEDS
from pipeline.expert.settings import BEST, EFFORTS, FIRST_SAFE, Settings

__all__ = [
    "BEST",
    "EFFORTS",
    "FIRST_SAFE",
    "SEEDS",
    "BackOff",
    "Settings",
    "Trajectory",
    "decoupled_optima",
    "nominal_plans",
    "solve",
    "solve_many",
    "with_back_off",
    "within_risk",
]
