"""What plans are worth, by their certificates."""

from collections.abc import Sequence

import numpy as np

from benchmarks.tables import Row
from pipeline.plan import SOLVED, Plan


def quality(plans: Sequence[Plan]) -> Row:
    """Columns of a table: unsafe plans, collisions, and fuel over the bound."""
    certificates = [plan.certificate for plan in plans]
    ratio = [c.fuel / c.fuel_lower_bound for c in certificates]
    return {
        "unsafe_%": 100 * float(np.mean([plan.status != SOLVED for plan in plans])),
        "node_collisions": float(np.mean([c.node_collisions for c in certificates])),
        "fuel/bound": f"{np.mean(ratio):.5f}",
    }
