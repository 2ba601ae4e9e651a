"""A dataset about an eccentric orbit: drawn, solved, read, and flown by an integrator."""

from functools import partial

import numpy as np
import pytest
from relative import linear_flight, pull

from pipeline.dataset.making import sample, solve
from pipeline.dataset.manifest import read_manifest
from pipeline.dataset.reading import read_solved
from pipeline.dataset.samples import Sample
from pipeline.dataset.verifying import verify
from pipeline.errors import InputError
from pipeline.expert import Settings
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.parallel.workers import Workers
from pipeline.storage.folder import open_folder
from pipeline.training.data import Examples, check_examples

PROBLEM = Problem().about(ReferenceOrbit(7.7e6, 0.1, 51.6, 20.0, 90.0, 100.0))


def test_rows_are_sound_and_fly_as_an_integrator_says(tmp_path):
    sample(
        tmp_path,
        {3: Sample("independent", count=6, shard_rows=3)},
        PROBLEM,
        workers=Workers(jobs=1),
    )
    solve(tmp_path, Settings(), workers=Workers(1))
    assert list(verify(tmp_path, workers=Workers(1))) == []
    folder = open_folder(tmp_path)
    manifest = read_manifest(folder)
    assert manifest.problem == PROBLEM
    begin = PROBLEM.orbit.states(np.zeros(1))[0]
    fly = linear_flight(begin, 120.0, 10, 1, partial(pull, j2=True))
    for shard in manifest.expected():
        rows = read_solved(folder, shard).to_pylist()
        assert len(rows) == 3
        for row in rows:
            assert row["status"] == "solved"
            states = np.reshape(row["states"], (3, 11, 6))
            flown = fly(states[:, 0], np.reshape(row["controls"], (3, 10, 3)))[:, :, -1]
            assert np.abs(flown - states[:, 1:])[..., :3].max() < 1e-6
            assert np.abs(np.reshape(row["goal"], (3, 6)) - states[:, -1]).max() < 1e-6


def test_networks_are_trained_about_circles():
    ends = np.zeros((2, 3, 6))
    with pytest.raises(InputError, match=r"about a reference orbit .*expected a circle"):
        check_examples(Examples(PROBLEM, ends, ends), Examples(PROBLEM, ends, ends))
