"""Plans as CSV and Parquet, as readers other than ours see them."""

import csv
import json

import duckdb
import numpy as np
import polars
import pyarrow.parquet as pq
import pytest

from pipeline.expert import solve
from pipeline.export.tables import write_csv, write_parquet
from pipeline.orbit.problem import Problem
from pipeline.scenario import draw

STATE, CONTROL = ["x", "y", "z", "vx", "vy", "vz"], ["ux", "uy", "uz"]


@pytest.fixture(scope="module")
def made():
    scenario = draw("rings", 0, 3, 0, Problem(nodes=5, time_step=100.1))
    return solve(scenario), scenario


def test_csv_holds_every_number_to_the_last_digit(made, tmp_path):
    plan, _ = made
    write_csv(plan, tmp_path / "p.csv")
    with (tmp_path / "p.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 3 * 5
    assert list(rows[0]) == ["craft", "node", "time_s", *STATE, *CONTROL]
    for row in rows:
        craft, node = int(row["craft"]), int(row["node"])
        assert float(row["time_s"]) == node * 100.1
        assert [float(row[name]) for name in STATE] == plan.states[craft, node].tolist()
        if node == 4:
            assert [row[name] for name in CONTROL] == ["", "", ""]
        else:
            assert [float(row[name]) for name in CONTROL] == plan.controls[craft, node].tolist()


def test_parquet_is_read_by_duckdb_and_polars_alike(made, tmp_path):
    plan, _ = made
    path = tmp_path / "p.parquet"
    write_parquet(plan, path)
    frame = polars.read_parquet(path)
    assert (frame.select(STATE).to_numpy().reshape(3, 5, 6) == plan.states).all()
    found = duckdb.sql(
        f"SELECT sum(abs(ux) + abs(uy) + abs(uz)), count(ux) FROM '{path}'"
    ).fetchall()
    assert found == [(pytest.approx(plan.certificate.fuel, rel=1e-12), 3 * 4)]


def test_parquet_carries_certificate_and_scenario(made, tmp_path):
    plan, scenario = made
    write_parquet(plan, tmp_path / "p.parquet")
    kept = json.loads(pq.read_schema(tmp_path / "p.parquet").metadata[b"prolearn"])
    assert kept["certificate"]["min_separation"] == plan.certificate.min_separation
    assert kept["status"] == "solved"
    assert np.array_equal(kept["scenario"]["goal"], scenario.goal)
