"""One craft's steps as ONNX files, run by onnxruntime in every craft of a swarm."""

import json
import platform
from dataclasses import asdict, replace

import numpy as np
import onnx
import pytest
import torch

from pipeline.errors import InputError, ProlearnError
from pipeline.files import write_text
from pipeline.networks.architecture import find
from pipeline.networks.model import load
from pipeline.networks.refiner.model import FOLDER, SAFE, STEADY, cheapest_safe, problem_data
from pipeline.networks.refiner.on_board import STEPS, outputs
from pipeline.networks.refiner.on_board_export import (
    ExportedCraft,
    Files,
    check,
    compare,
    export_craft,
    fly_rounds,
    swarm_controls,
)
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.orbit.transfer import fly
from pipeline.provenance import made_with
from pipeline.scenario import draw

# The tests' checks of shapes are no part of what is traced, and torch cannot trace them.
pytestmark = pytest.mark.untyped

PROBLEM, ROUNDS = Problem(), find("refiner").config["rounds"]
RADIUS = PROBLEM.collision_radius
UNIT = RADIUS / PROBLEM.time_step**2
DECIDING = tuple(f"pipeline/{part}" for part in ("networks", "orbit", "scenario", "*.py"))
"""Modules that decide what is in the files: what the exporter calls."""
RINGS, DENSE = [(2, 0), (4, 8), (10, 1), (10, 4)], [(5, 0), (5, 2)]
SWARMS = [("rings", *one) for one in RINGS] + [("dense", *one) for one in DENSE]


@pytest.fixture(scope="module")
def model():
    """The packaged refiner."""
    found = load(FOLDER)
    assert found.problem == PROBLEM
    return found


@pytest.fixture(scope="module")
def exported(model, pytestconfig, known_operators):
    """The files; those of an earlier run, where nothing that decides them has changed since.

    To trace them takes most of a minute.
    """
    made = made_with(DECIDING, ("onnx", "onnxruntime", "onnxscript", "torch"))
    of = {"model": model.digest, "python": platform.python_version(), **made}
    folder = pytestconfig.cache.mkdir("craft")
    told = folder / "told.json"
    found = json.loads(told.read_bytes()) if told.exists() else {}
    if found.get("of") != of:
        craft = export_craft(model, folder, about={"arch": "refiner"})
        found = {"of": of, "craft": asdict(replace(craft, folder=None))}
        write_text(told, json.dumps(found))
    return ExportedCraft(**{**found["craft"], "folder": folder})


def flown(run, ends):
    """Controls of each round by the files, (rounds + 1, n, m), and whether they are safe."""
    near, counts = np.full(ROUNDS + 1, np.inf), set()

    def noting(name, known):
        found = run(name, known)
        if name == "look":
            number = int(known["number"])
            near[number] = min(near[number], found["distance"].min())
            counts.add(len(known["interval"]))
        return found

    # One round more, of which only the look at the last controls counts.
    found = list(fly_rounds(noting, *ends, RADIUS, rounds=ROUNDS + 1))
    return np.stack(found[:-1]), near >= SAFE * RADIUS, counts


def cheapest(fuel, safe):
    """Which round a swarm flies, by what its craft tell of fuel and distances."""
    for number in range(1, ROUNDS + 1):
        if safe[number] and abs(fuel[number] - fuel[number - 1]) <= STEADY * fuel[number - 1]:
            break
    costs = np.where(safe, fuel, np.inf)[: number + 1]
    return int(costs.argmin()) if np.isfinite(costs).any() else number


def test_a_swarm_whose_craft_run_the_files_finds_what_the_swarm_finds(model, exported):
    run, compared, encounters = Files(exported.folder), [], set()
    for family, n, k in SWARMS:
        scenario = draw(family, 0, n, k, PROBLEM, "valid")
        ends = scenario.initial, scenario.goal
        controls, safe, counts = flown(run, ends)
        encounters |= counts
        data = problem_data(PROBLEM, *(end[None] for end in ends), np.array([RADIUS]))
        found = compare(controls, swarm_controls(model.network, PROBLEM, *ends))
        compared.append(found)
        if not found.tie:
            chosen = controls[cheapest(np.abs(controls).sum(axis=(1, 2)), safe)]
            best, is_safe = cheapest_safe(model.network.arrays, data, ROUNDS)
            assert bool(is_safe) == safe.any()
            assert np.abs(chosen - best * UNIT).max() <= 1e-5 * np.abs(chosen).max()
        reached = fly(ends[0], controls[-1].reshape(n, -1, 3), PROBLEM)[:, -1]
        assert np.abs(reached - ends[1])[:, :3].max() < 1e-6
    assert max(one.difference for one in compared) <= 1e-5
    assert sum(one.tie for one in compared) <= 1  # else little would have been compared
    assert min(encounters) == 1 and max(encounters) > 20


def test_the_files_say_by_name_what_goes_in_and_out(exported):
    for name, step in STEPS.items():
        graph = onnx.load(exported.folder / f"{name}.onnx")
        assert tuple(one.name for one in graph.graph.input) == step.takes
        assert tuple(one.name for one in graph.graph.output) == outputs(step)
        (kept,) = [p.value for p in graph.metadata_props if p.key == "prolearn"]
        about = json.loads(kept)
        assert (about["step"], about["arch"]) == (name, "refiner")
        assert about["tells"] == list(step.tells)
        free = {
            axis.dim_param
            for one in (*graph.graph.input, *graph.graph.output)
            for axis in one.type.tensor_type.shape.dim
            if axis.dim_param
        }
        assert free == {"begin": set(), "meet": {"Q"}}.get(name, {"P"})
    assert exported.difference <= 1e-5
    assert exported.seconds.keys() == exported.kib.keys() == STEPS.keys()


def test_files_are_checked_for_a_radius_at_which_rings_of_thirty_craft_do_not_fit(model, exported):
    wide = model.on(replace(PROBLEM, collision_radius=100.0))
    wide.network.rounds = ROUNDS // 2  # the same encounters and the same files in all of them
    found = check(exported.folder, wide)
    assert (found.encounters, found.ties) == (exported.encounters, exported.ties)
    assert found.difference <= 1e-5


def test_files_of_other_weights_are_found_out(model, exported, monkeypatch):
    monkeypatch.setattr("pipeline.networks.refiner.on_board_export.SIZES", (10,))
    other = find("refiner").network(model.config, model.encoding, 0.0)
    torch.nn.init.normal_(other.offer.weight, std=0.05)
    with pytest.raises(ProlearnError, match="controls differ from the model's by"):
        check(exported.folder, replace(model, network=other))


def test_a_file_in_the_folder_s_place_is_left_alone(model, tmp_path):
    (tmp_path / "craft").write_text("mine")
    with pytest.raises(InputError, match="is a file; expected a folder"):
        export_craft(model, tmp_path / "craft")
    assert (tmp_path / "craft").read_text() == "mine"


OBLATE = PROBLEM.about(ReferenceOrbit(7e6, inclination_deg=51.6))


@pytest.mark.parametrize(
    ("other", "why"),
    [
        (replace(PROBLEM, nodes=3), "two intervals, which one pair of burns makes"),
        (replace(OBLATE, nodes=61, time_step=20.0), "60 intervals about an orbit where all motion"),
    ],
)
def test_a_time_grid_without_a_table_or_a_choice_is_refused(model, tmp_path, other, why):
    with pytest.raises(InputError, match=why):
        export_craft(model.on(other), tmp_path)
    assert not [*tmp_path.iterdir()]
