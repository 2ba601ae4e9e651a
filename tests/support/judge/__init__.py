"""An independent judge of plans and datasets: numpy, scipy and cvxpy, pyarrow to read Parquet.

It imports nothing of ours and shares no method with it, so where the two agree it means something:
controls are flown by matrix exponentials instead of a closed form, separation is bounded by
curvature instead of Bézier curves, and the fuel's lower bound is HiGHS's, proven by its dual.
"""

from judge.adrift import Adrift, closest_adrift
from judge.corridors import least_inside
from judge.datasets import DatasetReport, judge_dataset
from judge.fuel import Bound, least_fuel
from judge.keep_out import Closest, least_adrift, least_clearance, obstacle_at, outside
from judge.motion import Case, after, exact_step, fly
from judge.plans import Report, judge_plan
from judge.separation import Approaches, closest_approaches

__all__ = [
    "Adrift",
    "Approaches",
    "Bound",
    "Case",
    "Closest",
    "DatasetReport",
    "Report",
    "after",
    "closest_adrift",
    "closest_approaches",
    "exact_step",
    "fly",
    "judge_dataset",
    "judge_plan",
    "least_adrift",
    "least_clearance",
    "least_fuel",
    "least_inside",
    "obstacle_at",
    "outside",
]
