import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import InputError
from pipeline.training.loop import Trained
from registry.models import load
from registry.store import connect
from registry.training import DatasetInfo, record_training

PAGE = (Path(__file__).parents[2] / "docs" / "mlflow.md").read_text(encoding="utf-8")


def test_every_name_that_a_run_records_is_documented(
    folder: Path, trained: Trained, dataset: DatasetInfo
) -> None:
    version = record_training(trained, dataset, {"valid_position_rmse": 1.0})
    documented = set(re.findall(r"`([a-z_]+)`", PAGE))
    recorded = {*version.params, *version.metrics, *version.tags}
    assert recorded - documented == set()
    assert all(name == name.lower() for name in recorded)


def test_the_documented_cure_for_a_moved_project_works(
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    trained: Trained,
    dataset: DatasetInfo,
) -> None:
    record_training(trained, dataset)
    moved = folder.rename(tmp_path / "moved here")
    monkeypatch.chdir(moved)
    with pytest.raises(InputError, match="After moving a project"):
        connect()  # as commands do before they write a run
    assert not folder.exists(), "no file goes where the project was"
    code = PAGE.partition("## After moving a project")[2]
    code = code.partition("```python")[2].partition("```")[0]
    subprocess.run([sys.executable, "-c", code.replace("/the/old/folder", str(folder))], check=True)

    model, _ = load("ff1")

    initial, goal = np.random.default_rng(0).normal(0, 100, (2, 2, 3, 6))
    np.testing.assert_array_equal(
        model.predict(initial, goal), trained.model.predict(initial, goal)
    )
