"""An architecture of another distribution: the documented example, installed on the spot."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "architectures.md").read_text(encoding="utf-8")

PREDICT = """
import mlflow, numpy as np
model = mlflow.pyfunc.load_model("models:/prolearn-shared@champion")
for n in (1, 7):
    ends = np.ones((2, n, 6))
    states = model.predict({"initial": ends, "goal": 2 * ends})
    assert states.shape == (2, n, 11, 6) and np.isfinite(states).all()
print("predicted")
"""


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """A folder like site-packages in which pip would have put the documented example."""
    code = PAGE.partition("```python\n")[2].partition("```")[0]
    entry = PAGE.partition('[project.entry-points."prolearn.architectures"]\n')[2]
    site = tmp_path / "site"
    info = site / "their_networks-1.2.dist-info"
    info.mkdir(parents=True)
    (site / "my_networks.py").write_text(code, encoding="utf-8")
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: their-networks\nVersion: 1.2\n")
    (info / "entry_points.txt").write_text(
        "[prolearn.architectures]\n" + entry.partition("```")[0].replace('"', "")
    )
    return site


def test_the_documented_example_is_trained_and_loaded_like_the_built_in_ones(
    folder: Path, site: Path, solved: Path
) -> None:
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(site), str(Path(__file__).parents[2])]),
        "MLFLOW_TRACKING_URI": f"sqlite:///{folder / 'mlflow.db'}",
    }

    def python(code: str, *arguments: str) -> "subprocess.CompletedProcess[str]":
        return subprocess.run(
            [sys.executable, "-c", code, *arguments],
            env=environment,
            capture_output=True,
            text=True,
            timeout=120,
        )

    command = ("--arch", "shared", "--data", str(solved), "--n", "3", "--epochs", "3")
    trained = python("from cli.main import app; app()", "train", *command)
    assert trained.returncode == 0, trained.stderr
    assert "prolearn-shared version 1 (tuned)" in trained.stdout

    (needed,) = (folder / "mlruns").rglob("requirements.txt")
    assert "their-networks==1.2" in needed.read_text().split()
    (document,) = (folder / "mlruns").rglob("model.json")
    assert re.search('"architecture": "shared"', document.read_text())

    predicted = python(PREDICT)
    assert predicted.returncode == 0, predicted.stderr
    assert predicted.stdout.split() == ["predicted"]
