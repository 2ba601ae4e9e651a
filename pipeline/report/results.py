"""What a report is made from: result tables, example transfers and facts about the run."""

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from pipeline.errors import InputError
from pipeline.experiments.examples.run import Example

COLUMNS: dict[str, tuple[str, ...]] = {
    "trials": (
        *("planner", "recipe", "training_seed", "reading", "n", "trial", "node_collisions"),
        *("pair_conflicts", "safe", "min_separation", "fuel", "fuel_lower_bound", "boundary_error"),
        *("dynamics_error", "seconds", "convex_solves"),
    ),
    "warmstarts": (
        *("optimizer", "n", "trial", "seed", "training_seed", "rule", "convex_solves", "seconds"),
        *("optimality_gap", "fuel", "safe", "status"),
    ),
    "training": (
        *("arch", "recipe", "training_seed", "version", "parameters", "epochs", "best_epoch"),
        *("valid_loss", "seconds", "device", "threads", "train_instances", "weights_kib"),
    ),
    "curves": ("arch", "recipe", "training_seed", "epoch", "train_loss", "valid_loss"),
}
"""The columns that each table must have."""

COLUMNS["transfer_times"] = ("varied", "nodes", "time_step", *COLUMNS["trials"])


@dataclass(frozen=True, eq=False)
class Results:
    """Tables as the experiments leave them; all but ``trials`` may be absent or empty.

    Attributes:
        trials: a row for each planner, recipe, training seed, reading, n and trial
            (experiments 1 and 2).
        warmstarts: a row for each optimizer, n, trial, seed, training seed and stopping rule
            (experiment 3).
        training: a row for each trained model.
        curves: a row for each arch, recipe, training seed and epoch.
        examples: transfers to draw.
        provenance: a row for each run that a table comes from: part, run, made, data, digest,
            code, versions, machine.
        notes: what a reader must know of parts that are left out or were made otherwise.
        transfer_times: a row for each trial at each transfer time (experiment 4).

    Raises:
        InputError: ``trials`` is empty, or a table lacks a column of ``COLUMNS``.
    """

    trials: pd.DataFrame
    warmstarts: pd.DataFrame | None = None
    training: pd.DataFrame | None = None
    curves: pd.DataFrame | None = None
    examples: Sequence[Example] = ()
    provenance: pd.DataFrame | None = None
    notes: Sequence[str] = ()
    transfer_times: pd.DataFrame | None = None

    def __post_init__(self) -> None:
        if self.trials.empty:
            raise InputError(
                "the results hold no trials, and a report needs at least one planner's: "
                "run `prolearn evaluate` first"
            )
        for name, columns in COLUMNS.items():
            table = getattr(self, name)
            missing = [] if is_empty(table) else [c for c in columns if c not in table.columns]
            if missing:
                raise InputError(
                    f"the results table {name!r} lacks the columns {', '.join(missing)}: "
                    "write it with the prolearn of this report"
                )


def is_empty(table: pd.DataFrame | None) -> bool:
    """Whether a table is absent or has no rows."""
    return table is None or table.empty
