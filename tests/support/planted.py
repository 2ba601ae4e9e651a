"""Results with planted numbers, small enough to average by hand."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd
import pytest

from pipeline.figures.tables import Table
from pipeline.figures.transfer import Example
from pipeline.report import Results

Row = dict[str, Any]
"""The columns of a table's row by name."""

Made = Callable[..., list[Row]]
"""`planted`, as a fixture."""


def planted(
    planner: str,
    recipe: str,
    reading: str,
    n: int,
    collisions: Iterable[int],
    fuel: Iterable[float],
    safe: Iterable[bool | None],
    **more: object,
) -> list[Row]:
    """One row for each trial; the bound is 1 m/s² everywhere, so fuel is its own ratio."""
    predicted = reading == "predicted"
    row: Row = {
        "planner": planner,
        "recipe": recipe,
        "training_seed": 0,
        "reading": reading,
        "n": n,
        "fuel_lower_bound": 1.0,
        "boundary_error": 40.0 if predicted else 1e-12,
        "dynamics_error": 8.0 if predicted else 1e-12,
        "seconds": 0.25,
        "convex_solves": 1,
        "min_separation": np.nan if predicted else 20.0,
        "pair_conflicts": np.nan if predicted else 0.0,
    } | more
    return [
        row | {"trial": k, "node_collisions": c, "fuel": f, "safe": pd.NA if predicted else s}
        for k, (c, f, s) in enumerate(zip(collisions, fuel, safe, strict=True))
    ]


def one_size(n: int) -> list[Row]:
    """Two trials each of an expert, a baseline, two networks and one the paper does not know."""
    return [
        *planted("expert", "", "plan", n, [0, 0], [1.0, 1.02], [True, True], seconds=0.5),
        *planted("minimum energy", "", "plan", n, [0, 1], [1.3, 1.4], [True, False]),
        *planted("ff1", "paper", "predicted", n, [1, 4], [9.0, 11.0], [None, None]),
        *planted("ff1", "paper", "flown", n, [0, 3], [2.0, 4.0], [True, False]),
        *planted("lstm1", "paper", "predicted", n, [5, 8], [3.0, 5.0], [None, None]),
        *planted("lstm1", "paper", "flown", n, [4, 6], [2.0, 2.0], [False, False]),
        *planted("my net", "tuned", "flown", n, [0, 0], [1.05, 1.07], [True, True]),
    ]


def warm(
    n: int,
    rule: str,
    seed: str,
    solves: Sequence[int],
    seconds: Sequence[float],
    gaps: Sequence[float],
    safe: bool = True,
    training_seed: int = 0,
) -> list[Row]:
    return [
        {
            "optimizer": "expert",
            "n": n,
            "rule": rule,
            "seed": seed,
            "training_seed": training_seed,
            "trial": k,
            "convex_solves": c,
            "seconds": t,
            "optimality_gap": g,
            "fuel": 1.0,
            "safe": safe,
            "status": "solved",
        }
        for k, (c, t, g) in enumerate(zip(solves, seconds, gaps, strict=True))
    ]


@pytest.fixture
def trials() -> pd.DataFrame:
    return pd.DataFrame([*one_size(10), *one_size(30)])


@pytest.fixture
def trials_at() -> Callable[..., pd.DataFrame]:
    return lambda *sizes: pd.DataFrame([row for n in sizes for row in one_size(n)])


@pytest.fixture
def rows() -> Made:
    return planted


@pytest.fixture
def warmstarts() -> pd.DataFrame:
    return pd.DataFrame(
        [
            *warm(10, "first safe", "none", [1, 2, 3], [0.2, 0.4, 0.9], [0.01, 0.02, 0.03]),
            *warm(10, "first safe", "ff1 tuned", [1, 1, 4], [0.1, 0.1, 0.7], [0.0, 0.3, np.inf]),
            *warm(10, "converged", "ff1 tuned", [2, 2, 2], [1.0, 1.0, 1.0], [0.0, 0.0, 0.0]),
        ]
    )


@pytest.fixture
def both(warmstarts: pd.DataFrame) -> pd.DataFrame:
    """The expert's warm starts, and those of the plain SCP, most of them unsafe between nodes."""
    plain = [
        *warm(10, "converged", "none", [8, 10, 12], [2.0, 4.0, 9.0], [0.1] * 3, False),
        *warm(10, "converged", "decoupled optimum", [1, 1, 1], [0.5] * 3, [0.0] * 3, False),
        *warm(10, "converged", "ff1 tuned", [1, 2, 3], [0.5, 1.0, 1.5], [0.01] * 3, True),
    ]
    return pd.concat([warmstarts, pd.DataFrame(plain).assign(optimizer="plain")])


@pytest.fixture
def example() -> Example:
    """Two craft that pass each other 10 m apart, on drift-free orbits of mean motion 0.001."""
    end = np.array([[100.0, 0, 0, 0, -0.2, 0], [-100.0, 0, 0, 0, 0.2, 0]])
    x = np.linspace(100, -100, 41)
    apart = np.full(41, 5.0)
    track = np.stack([np.stack([s * x, s * apart, 0 * x], axis=1) for s in (1.0, -1.0)])
    return Example("Two craft swap places", end, end[::-1].copy(), {"expert": track}, 15.0)


@pytest.fixture
def results(trials: pd.DataFrame, warmstarts: pd.DataFrame, example: Example) -> Results:
    training = pd.DataFrame(
        [
            {
                "arch": arch,
                "recipe": "paper",
                "training_seed": 0,
                "version": "1",
                "n": 10,
                "parameters": 1234,
                "epochs": 30,
                "best_epoch": 25,
                "valid_loss": 0.00125,
                "seconds": 12.5,
                "device": "cpu",
                "threads": "2",
                "train_instances": 8000,
                "weights_kib": 4.82,
                "valid_flown_safe_share": None,
                "valid_flown_fuel": None,
                "valid_flown_trials": None,
            }
            for arch in ("lstm1", "my net", "ff1")
        ]
    )
    curves = pd.DataFrame(
        [
            {"arch": a, "recipe": "paper", "training_seed": 0, "epoch": e}
            | {"train_loss": 1 / e, "valid_loss": 2 / e}
            for a in ("ff1", "lstm1", "my net")
            for e in (1, 2, 3)
        ]
    )
    provenance = pd.DataFrame(
        [
            {
                "part": "pairs | nodes",
                "run": "0123456789abcdef",
                "made": "2026-01-01 12:00 UTC",
                "data": "see <http://example.org> and [a](http://b.c)",
                "digest": "fedcba9876543210",
                "code": "0123abc",
                "versions": "numpy 2.0",
                "machine": "Linux, 2 cores",
            }
        ]
    )
    return Results(trials, warmstarts, training, curves, [example], provenance)


def cells(table: Table) -> tuple[list[str], list[list[str]]]:
    """The head and the rows of a printed table."""
    lines = [
        [c.strip() for c in line.strip("|").split("|")] for line in table.markdown.splitlines()
    ]
    return lines[0], lines[2:]


def shares(safe: int, of: int = 400) -> list[bool]:
    """So many safe trials, in an order that has nothing to do with other planners'."""
    return [k * 7 % of < safe for k in range(of)]


def trained(*rows: tuple[object, ...]) -> pd.DataFrame:
    """Networks with their share of safe validation scenarios and their fuel there."""
    columns = ["arch", "recipe", "valid_flown_safe_share", "valid_flown_fuel"]
    return pd.DataFrame(rows, columns=columns).assign(valid_flown_trials=500, n=10)


def flown(
    rows: Made,
    planner: str,
    recipe: str,
    safe: Sequence[bool],
    fuel: float,
    n: int = 10,
    seed: int = 0,
    reading: str = "flown",
) -> list[Row]:
    fuels = [fuel + 0.01 * (-1) ** k for k in range(len(safe))]
    return rows(planner, recipe, reading, n, [0] * len(safe), fuels, safe, training_seed=seed)


def row(table: pd.DataFrame, **keys: object) -> Any:
    chosen = table
    for key, value in keys.items():
        chosen = chosen[chosen[key] == value]
    assert len(chosen) == 1
    return chosen.iloc[0]
