"""What a disk without space does to a training's record: a real one, of a few MB."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from shlex import quote

import numpy as np
import pytest
from forked import Forked

from pipeline.networks.model import load as load_network
from pipeline.networks.model import save
from pipeline.training.loop import Trained
from registry.models import load
from registry.training import register_kept

DISK = """
import ctypes, os, subprocess

NEW_USER, NEW_MOUNTS = 0x10000000, 0x00020000  # as linux/sched.h has them
library, user, group = ctypes.CDLL(None, use_errno=True), os.getuid(), os.getgid()
if library.unshare(NEW_USER | NEW_MOUNTS) != 0:
    raise OSError(ctypes.get_errno(), "unshare")
known = {{"setgroups": "deny", "uid_map": f"0 {{user}} 1", "gid_map": f"0 {{group}} 1"}}
for name, said in known.items():
    with open(f"/proc/self/{{name}}", "w") as file:
        file.write(said)
subprocess.run(["mount", "-t", "tmpfs", "-o", "size={size}k", "none", {path!r}], check=True)
"""
"""Mounts a disk that this process alone sees, which it may as root of a namespace of its own."""

SCRIPT = """
{disk}
import shutil
from pathlib import Path
from shlex import quote
from pipeline.dataset.examples import Examples
from pipeline.errors import ProlearnError
from pipeline.networks.model import load
from pipeline.training.loop import Epoch, Trained
from pipeline.networks.architecture import recipe_for
from registry.training import DatasetInfo, record_training

shutil.copy("mlflow.db", {path!r})
os.chdir({here!r})
model = load(Path({network!r}))
trained = Trained(model, recipe_for("ff1", "tuned"), 0, (Epoch(1, 1.0, 1.0, 0.1),), 1, 0.1, "cpu")
dataset = DatasetInfo("data/paper", "0" * 64, 20, 5)
try:
    record_training(trained, dataset)
except ProlearnError as error:
    print(error)
"""


def mounting_works() -> bool:
    code = DISK.format(size=1024, path="/mnt")
    return subprocess.run([sys.executable, "-c", code], capture_output=True).returncode == 0


pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(not mounting_works(), reason="needs the right to mount a tmpfs"),
]


@pytest.fixture
def record_on(
    folder: Path, network: Path, forked: Forked, tmp_path: Path
) -> Callable[[Path, Path], str]:
    """What a training says in a folder, whose store is on a disk that has no room for more."""

    def record(disk: Path, here: Path) -> str:
        disk.mkdir()
        size = (folder / "mlflow.db").stat().st_size // 1024 + 102  # KiB: the empty store, 0.1 MiB
        mounted = DISK.format(size=size, path=str(disk))
        code = SCRIPT.format(disk=mounted, path=str(disk), here=str(here), network=str(network))
        store = f"sqlite:///{disk / 'mlflow.db'}"
        given = {**os.environ, "MLFLOW_TRACKING_URI": store, "TMPDIR": str(network)}
        done = forked.run((), folder, given, code=code)
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    return record


@pytest.fixture
def network(tmp_path: Path, trained: Trained) -> Path:
    save(trained.model, tmp_path / "network")
    return tmp_path / "network"


def test_a_store_on_a_full_disk_fails_in_a_sentence_and_the_network_is_kept_and_registered_later(
    folder: Path,
    tmp_path: Path,
    record_on: Callable[[Path, Path], str],
    trained: Trained,
) -> None:
    said = record_on(tmp_path / "disk", folder)

    assert "prolearn models register" in said and "space on the disk" in said
    assert len(said.splitlines()) == 1, said
    (kept,) = (folder / "unregistered").iterdir()
    assert f"prolearn models register {quote(str(kept))}`" in said
    initial, goal = np.random.default_rng(0).normal(0, 100, (2, 2, 3, 6))
    wanted = trained.model.predict(initial, goal)
    np.testing.assert_array_equal(load_network(kept).predict(initial, goal), wanted)

    version = register_kept(kept)  # in the folder's own store, which has space

    np.testing.assert_array_equal(load("ff1")[0].predict(initial, goal), wanted)
    assert version.params["recipe"] == "tuned" and version.params["dataset"] == "data/paper"
    assert version.metrics["best_valid_loss"] == 1.0
    assert version.tags["torch_version"]


def test_where_even_the_current_folder_is_full_the_sentence_says_so(
    folder: Path, tmp_path: Path, record_on: Callable[[Path, Path], str]
) -> None:
    said = record_on(tmp_path / "disk", tmp_path / "disk")

    assert "neither be registered nor be kept" in said and "No space left on device" in said
    assert len(said.splitlines()) == 1, said
    assert shutil.disk_usage(folder).free > 0, "the disk is the test's own"
