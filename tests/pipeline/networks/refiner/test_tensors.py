"""Plans by torch equal those of the compiled code in double precision; here on the CPU."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.arrays import plain
from pipeline.errors import InputError
from pipeline.networks.document import portions
from pipeline.networks.refiner import geometry, tensors
from pipeline.networks.refiner.model import TrainedRefiner, packaged
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.scenario import draw

PROBLEM, REFINER = Problem(), replace(packaged(), device="cpu")
ECCENTRIC = ReferenceOrbit(1.2e7, eccentricity=0.2, inclination_deg=60.0)


def ends(family, n, count, problem):
    drawn = [draw(family, k, n, 0, problem) for k in range(count)]
    return (np.stack([getattr(one, name) for one in drawn]) for name in ("initial", "goal"))


def both(family, n, count, problem, trained=REFINER):
    """Controls of swarms planned together on the device, and one by one by the compiled code."""
    initial, goal = ends(family, n, count, problem)
    of, radius = trained.on(problem), problem.collision_radius
    each = [of.answer(initial[k : k + 1], goal[k : k + 1], radius) for k in range(count)]
    return of.answer(initial, goal, radius), np.concatenate(each)


def off(found, wanted):
    """Largest difference of the controls of each swarm, as a share of the largest of them."""
    return abs(found - wanted).max(axis=(1, 2, 3)) / abs(wanted).max(axis=(1, 2, 3))


@pytest.mark.parametrize(
    ("family", "n", "problem"),
    [
        ("rings", 10, PROBLEM),
        ("rotation", 10, PROBLEM),
        ("rings", 30, PROBLEM),
        ("rings", 1, PROBLEM),  # nobody to meet
        ("rings", 5, replace(PROBLEM, nodes=3)),  # no choice
        ("rings", 8, replace(PROBLEM, nodes=4)),
        ("rings", 8, PROBLEM.about(ECCENTRIC)),
        ("rings", 6, replace(PROBLEM, time_step=28.0, nodes=43).about(ECCENTRIC)),  # no table
    ],
)
def test_swarms_are_planned_as_by_the_compiled_code(family, n, problem):
    assert off(*both(family, n, 4, problem)).max() < 1e-9


def test_of_dense_swarms_which_magnify_what_rounding_there_is_at_least_the_half_are():
    found, wanted = both("dense", 10, 12, PROBLEM)
    assert np.median(off(found, wanted)) < 1e-9
    used = [abs(controls).sum(axis=(1, 2, 3)) for controls in (found, wanted)]
    assert used[0] == pytest.approx(used[1], rel=1e-5)


def test_by_the_rule_alone_too():
    rule = TrainedRefiner(None, 8, PROBLEM, "", "cpu")
    assert off(*both("rings", 10, 4, PROBLEM, rule)).max() < 1e-9


def test_weights_count_in_double_precision_on_a_device_however_many_swarms():
    """A swarm alone, which the compiled code plans, has the controls that it has among others."""
    initial, goal = ends("dense", 10, 1, PROBLEM)
    single = packaged().answer(initial, goal, 15.0)
    found = REFINER.answer(initial, goal, 15.0)
    assert not np.array_equal(found, single)
    assert found == pytest.approx(single, abs=1e-3 * abs(single).max())


def test_encounters_are_those_of_the_compiled_code_however_many_are_looked_at_together(
    monkeypatch,
):
    initial, goal = ends("dense", 12, 5, PROBLEM)
    radius = np.full(5, 15.0)
    data = tensors.problem_data(PROBLEM, initial, goal, radius, torch.device("cpu"))
    states = data.grid.fly(data.initial, data.own.controls)
    wanted = geometry.encounters(plain(states), 12)
    wanted = sorted(zip(*(one.tolist() for one in vars(wanted).values()), strict=True))
    assert len(wanted) > 500
    for many in (tensors.PAIRS_AT_ONCE, 1, 2000):
        monkeypatch.setattr(tensors, "PAIRS_AT_ONCE", many)
        found = tensors.encounters(states, 12)
        assert sorted(zip(*(one.tolist() for one in vars(found).values()), strict=True)) == wanted


def test_more_swarms_are_planned_together_on_a_device():
    some = np.zeros((300, 10, 6))
    assert [part.stop - part.start for part in portions(some, some, 21)] == [238, 238]
    assert [part.stop - part.start for part in portions(some, some, 21, "cuda")] == [4761]


def test_a_device_that_is_not_there_or_has_too_little_memory_is_refused(monkeypatch):
    initial, goal = ends("rings", 3, 2, PROBLEM)
    with pytest.raises(InputError, match="expected cpu, or cuda"):
        replace(REFINER, device="cuda:99").answer(initial, goal, 15.0)

    def full(*_):
        raise torch.OutOfMemoryError("CUDA out of memory")

    monkeypatch.setattr(tensors, "problem_data", full)
    with pytest.raises(InputError, match="too little memory left for 2 swarms of 3 craft"):
        REFINER.answer(initial, goal, 15.0)
