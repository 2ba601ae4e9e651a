"""The judge of datasets: rows worked out by hand, and what is planted among them."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from judge import judge_dataset

ABOUT = {
    "mean_motion": 1e-12,  # as good as free space
    "time_step": 10.0,
    "nodes": 5,
    "collision_radius": 15.0,
    "max_acceleration": None,
    "separation": "continuous",
}
PUSH = 0.1
"""m/s² in the first interval and back in the last: 30 m further on, the cheapest way there."""


def row(index, split, n=2):
    """Craft 100 m apart that all move 30 m along x, at 1 m/s but for the first and last 10 s."""
    x, v = np.array([0.0, 5, 15, 25, 30]), np.array([0.0, 1, 1, 1, 0])
    states = np.zeros((n, 5, 6))
    states[..., 0], states[..., 3] = x, v
    states[..., 1] = 100 * np.arange(n)[:, None] + index
    controls = np.zeros((n, 4, 3))
    controls[:, 0, 0], controls[:, 3, 0] = PUSH, -PUSH
    return {
        "scenario_id": f"row-{index}",
        "n_spacecraft": n,
        "family": "by hand",
        "split": split,
        "initial": states[:, 0].ravel().tolist(),
        "goal": states[:, -1].ravel().tolist(),
        "status": "solved",
        "states": states.ravel().tolist(),
        "controls": controls.ravel().tolist(),
        "fuel": 2 * PUSH * n,
        "fuel_lower_bound": 2 * PUSH * n,
        "optimality_gap": 0.0,
        "node_collisions": 0,
        "min_separation": 100.0 if n > 1 else None,
        "convex_solves": 1,
    }


PLANLESS = {
    **dict.fromkeys(["states", "controls", "fuel", "fuel_lower_bound", "optimality_gap"]),
    **dict.fromkeys(["node_collisions", "min_separation"]),
}


def written(folder, rows, name="n=2/part-00000.parquet", **about):
    table = pa.Table.from_pylist(rows)
    meta = {b"prolearn": json.dumps(ABOUT | about).encode()}
    (folder / name).parent.mkdir(exist_ok=True)
    pq.write_table(table.replace_schema_metadata(meta), folder / name, write_page_checksum=True)
    return folder


def rows():
    unsolved = row(3, "test") | PLANLESS | {"status": "infeasible"}
    return [row(0, "train"), row(1, "valid"), row(2, "test"), unsolved]


def test_a_sound_dataset_has_no_faults_and_is_counted(tmp_path):
    written(tmp_path, rows())
    written(tmp_path, [row(9, "train", n=1)], "n=1/part-00000.parquet")
    written(tmp_path, [{"what": "no plans"}], "_scenarios/part-00000.parquet")
    report = judge_dataset(tmp_path)
    assert report.faults == ()
    assert report.statuses == {"solved": 4, "infeasible": 1}
    assert report.splits == {"train": 2, "valid": 1, "test": 2}


def shifted(column, by, index=0):
    def change(found):
        if isinstance(found[1][column], list):
            found[1][column][index] += by
        else:
            found[1][column] += by

    return change


def told(**values):
    return lambda found: found[1].update(values)


def training_row_with_its_craft_in_another_order(found):
    for end in ("initial", "goal"):
        found[2][end] = np.reshape(found[0][end], (2, 6))[::-1].ravel().tolist()
    for name, shape in (("states", (2, 30)), ("controls", (2, 12))):
        found[2][name] = np.reshape(found[0][name], shape)[::-1].ravel().tolist()


def planned_without_success(found):
    found[3]["fuel"] = 1.0


@pytest.mark.parametrize(
    ("plant", "words"),
    [
        (shifted("states", 1e-3, 6), "row-1 states are 0.001 m"),
        (shifted("controls", 1e-6), "row-1 misses the goal"),
        (shifted("goal", 1e-3, 3), "row-1 misses the goal's velocity by 0.001 m/s"),
        (shifted("fuel", 1e-5), "row-1 fuel is said to be"),
        (shifted("fuel_lower_bound", 1e-5), "row-1 fuel_lower_bound is said to be"),
        (shifted("optimality_gap", 1e-3), "row-1 optimality_gap is said to be"),
        (shifted("node_collisions", 1), "row-1 node_collisions is said to be 1"),
        (shifted("min_separation", 1e-2), "row-1 min_separation is said to be 100.01"),
        (told(min_separation=None), "row-1 is solved and has"),
        (told(states=None), "row-1 is solved and has"),
        (told(status="done"), "row-1 has status 'done'"),
        (told(split="dev"), "row-1 has split 'dev'"),
        (told(scenario_id="row-0"), "2 rows are called row-0"),
        (told(n_spacecraft=3), "row-1 of n=3 is in n=2"),
        (told(controls=[0.0]), "row-1 cannot be judged"),
        (planned_without_success, "row-3 is infeasible and has fuel"),
        (training_row_with_its_craft_in_another_order, "row-2 of test is row-0 of train"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_is_planted_in_a_row_is_found(tmp_path, plant, words):
    found = rows()
    plant(found)
    faults = judge_dataset(written(tmp_path, found)).faults
    assert any(fault.startswith(words) for fault in faults), faults


def test_the_metadata_s_own_problem_is_what_rows_are_held_against(tmp_path):
    faults = judge_dataset(written(tmp_path, rows(), max_acceleration=0.09)).faults
    assert "row-0 uses 0.1 m/s² of 0.09 m/s²" in faults
    faults = judge_dataset(written(tmp_path, rows(), collision_radius=100.1)).faults
    assert "row-0 comes within 100.1 m at a node" in faults


def test_files_of_two_problems_missing_columns_and_empty_folders_are_found(tmp_path):
    assert judge_dataset(tmp_path).faults == ("there are no rows",)
    written(tmp_path, rows())
    few = [{k: v for k, v in r.items() if k != "fuel"} for r in rows()]
    written(tmp_path, few, "n=2/part-00001.parquet")
    written(tmp_path, [row(9, "train")], "n=2/part-00002.parquet", collision_radius=14.0)
    faults = judge_dataset(tmp_path).faults
    assert "n=2/part-00001.parquet has no fuel" in faults
    assert "files are of different problems" in faults


def test_craft_kept_apart_at_the_nodes_alone_are_judged_there(tmp_path):
    """The second craft comes the other way: 10 m off at two nodes, 1 m off between them."""
    crossing = row(0, "train")
    states = np.reshape(crossing["states"], (2, 5, 6))
    states[1, :, 0], states[1, :, 3] = 40 - states[1, :, 0], -states[1, :, 3]
    states[1, :, 1] = 1.0
    controls = np.reshape(crossing["controls"], (2, 4, 3)) * [[[1.0]], [[-1.0]]]
    crossing |= {
        "states": states.ravel().tolist(),
        "controls": controls.ravel().tolist(),
        "initial": states[:, 0].ravel().tolist(),
        "goal": states[:, -1].ravel().tolist(),
        "min_separation": 1.0,
    }
    written(tmp_path, [crossing], separation="nodes", collision_radius=5.0)
    assert judge_dataset(tmp_path).faults == ()
    written(tmp_path, [crossing], separation="continuous", collision_radius=5.0)
    assert judge_dataset(tmp_path).faults == ("row-0 comes as close as 1 m between nodes",)
