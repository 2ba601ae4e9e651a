"""Facets of hulls from the cache folder: those of Qhull, whatever is in the folder."""

import subprocess
import sys

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from pipeline.orbit.hulls import corners

CLOUDS = [np.random.default_rng(k).normal(size=(20, k)) for k in (2, 4)]
CODE = """
import os, sys
import numpy as np
from pipeline.orbit.hulls import corners

clouds = [np.random.default_rng(k).normal(size=(20, k)) for k in (2, 4)]
for line in sys.stdin:
    if child := os.fork():
        assert os.waitpid(child, 0)[1] == 0
        continue
    os.environ["XDG_CACHE_HOME"] = line.rstrip()
    np.savez(sys.argv[1], *corners(clouds))
    print("scipy" in sys.modules, flush=True)
    os._exit(0)
"""
"""For each folder for caches that it reads, corners in a new process, forked before SciPy."""


@pytest.fixture(scope="module")
def forks(tmp_path_factory):
    """A process that does this, and the file of corners."""
    found = tmp_path_factory.mktemp("corners") / "found.npz"
    command = (sys.executable, "-c", CODE, str(found))
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        yield process, found
    assert process.returncode == 0


@pytest.fixture
def in_a_new_process(forks):
    """Corners as a process without SciPy has them, and whether it imported that."""
    process, found = forks

    def ask(folder):
        process.stdin.write(f"{folder}\n")
        process.stdin.flush()
        computed = process.stdout.readline()
        assert computed in ("True\n", "False\n")
        with np.load(found) as file:
            return [file["arr_0"], file["arr_1"]], computed == "True\n"

    return ask


def are_qhulls(found):
    return all(
        np.array_equal(one, ConvexHull(points).simplices)
        for one, points in zip(found, CLOUDS, strict=True)
    )


def test_they_are_computed_once_and_whatever_is_in_the_file_they_are_right(
    in_a_new_process, tmp_path
):
    folder = tmp_path / "cache"
    found, computed = in_a_new_process(folder)
    assert computed and are_qhulls(found)
    found, computed = in_a_new_process(folder)
    assert not computed and are_qhulls(found)
    (file,) = folder.glob("*/*")
    whole = file.read_bytes()
    others = [CLOUDS[0] + 1, CLOUDS[1], *corners(CLOUDS)]
    fewer = [CLOUDS[0], *corners(CLOUDS[:1])]  # as of a problem whose digest begins alike
    flipped = whole[:300] + b"\0\1" + whole[302:]
    for damaged in (b"", b"nonsense", whole[:-100], flipped, others, fewer):
        if isinstance(damaged, list):
            np.savez(file, *damaged)
        else:
            file.write_bytes(damaged)
        found, computed = in_a_new_process(folder)
        assert computed and are_qhulls(found)
        assert file.read_bytes() == whole


def test_a_folder_that_cannot_be_written_does_no_harm(in_a_new_process, tmp_path):
    (tmp_path / "file").write_text("in the way")
    found, computed = in_a_new_process(tmp_path / "file")
    assert computed and are_qhulls(found)
