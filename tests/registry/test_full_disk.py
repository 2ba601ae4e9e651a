"""What a disk without space does to a training's record: a real one, of a few MB."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pipeline.networks.model import load as load_network
from pipeline.networks.model import save
from pipeline.training.loop import Trained
from registry.models import load
from registry.training import register_kept

UNSHARE = ("unshare", "--map-root-user", "--mount")

SCRIPT = """
from pathlib import Path
from pipeline.dataset.examples import Examples
from pipeline.errors import ProlearnError
from pipeline.networks.model import load
from pipeline.training.loop import Epoch, Trained
from pipeline.networks.architecture import recipe_for
from registry.training import DatasetInfo, record_training

model = load(Path({network!r}))
trained = Trained(model, (Epoch(1, 1.0, 1.0, 0.1),), 1, 0.1, "cpu")
dataset = DatasetInfo("data/paper", "0" * 64, 20, 5)
try:
    record_training(trained, recipe=recipe_for("ff1", "tuned"), seed=0, dataset=dataset)
except ProlearnError as error:
    print(error)
"""


def mounting_works() -> bool:
    try:
        done = subprocess.run(
            [*UNSHARE, "sh", "-c", "mount -t tmpfs -o size=1m none /mnt"], capture_output=True
        )
    except OSError:
        return False
    return done.returncode == 0


pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(
        not mounting_works(), reason="needs util-linux's unshare and the right to mount a tmpfs"
    ),
]


def record_on(disk: Path, mebibytes: float, network: Path, here: Path, store: Path) -> str:
    """What a training says whose store is on a disk of its own that is as small as that."""
    size = int(mebibytes * 1024)
    mount = f'mount -t tmpfs -o size={size}k none "$1" && cp mlflow.db "$1" && cd "$2"'
    code = SCRIPT.format(network=str(network))
    arguments = (str(disk), str(here), sys.executable, code)
    done = subprocess.run(
        [*UNSHARE, "sh", "-c", f'{mount} && exec "$3" -c "$4"', "sh", *arguments],
        env={**os.environ, "MLFLOW_TRACKING_URI": f"sqlite:///{store}", "TMPDIR": str(network)},
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    return done.stdout.strip()


@pytest.fixture
def network(tmp_path: Path, trained: Trained) -> Path:
    save(trained.model, tmp_path / "network")
    return tmp_path / "network"


def room(folder: Path) -> float:
    """MiB of the empty store."""
    return (folder / "mlflow.db").stat().st_size / 2**20


def test_a_store_on_a_full_disk_fails_in_a_sentence_and_the_network_is_kept_and_registered_later(
    folder: Path, tmp_path: Path, network: Path, trained: Trained
) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()

    said = record_on(disk, room(folder) + 0.1, network, folder, disk / "mlflow.db")

    assert "prolearn models register" in said and "space on the disk" in said
    assert len(said.splitlines()) == 1, said
    (kept,) = (folder / "unregistered").iterdir()
    assert str(kept) in said
    initial, goal = np.random.default_rng(0).normal(0, 100, (2, 2, 3, 6))
    wanted = trained.model.predict(initial, goal)
    np.testing.assert_array_equal(load_network(kept).predict(initial, goal), wanted)

    version = register_kept(kept)  # in the folder's own store, which has space

    np.testing.assert_array_equal(load("ff1")[0].predict(initial, goal), wanted)
    assert version.params["recipe"] == "tuned" and version.params["dataset"] == "data/paper"
    assert version.metrics["best_valid_loss"] == 1.0
    assert version.tags["torch_version"]


def test_where_even_the_current_folder_is_full_the_sentence_says_so(
    folder: Path, tmp_path: Path, network: Path
) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()

    said = record_on(disk, room(folder) + 0.1, network, disk, disk / "mlflow.db")

    assert "neither be registered nor be kept" in said and "No space left on device" in said
    assert len(said.splitlines()) == 1, said
    assert shutil.disk_usage(folder).free > 0, "the disk is the test's own"
