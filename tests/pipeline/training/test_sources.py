"""Fresh scenarios without end, and networks that learn from them without the expert."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.dataset.reading.examples import Examples
from pipeline.errors import InputError
from pipeline.networks.architecture import find
from pipeline.networks.encoding import fit
from pipeline.networks.model import load, save
from pipeline.networks.recipes import recipe_for
from pipeline.orbit.cw import cw_matrices
from pipeline.orbit.problem import Problem
from pipeline.planners.network import Flown
from pipeline.scenario import draw
from pipeline.training.data import Preparation, batches
from pipeline.training.loop import train
from pipeline.training.sources import FreshDraws

PROBLEM = Problem(nodes=6)
FRESH = FreshDraws("rings", 4, 3, PROBLEM, count=40)


def scenarios(count, n=3, split="valid", problem=PROBLEM):
    return [draw("rings", 1, n, k, problem, split) for k in range(count)]


def valid(count=60):
    drawn = scenarios(count)
    return Examples(
        PROBLEM, *(np.stack([getattr(s, e) for s in drawn]) for e in ("initial", "goal"))
    )


def trained(arch, *, seed=0, epochs=3, source=FRESH, **changes):
    recipe = replace(recipe_for(arch, "tuned"), batch_size=16, **changes)
    return train(arch, recipe, source, valid(), seed=seed, device="cpu", epochs=epochs)


def weights(found):
    return torch.cat([p.flatten() for p in found.model.network.state_dict().values()])


def test_a_pass_has_the_training_scenarios_after_those_of_the_pass_before():
    first, third = FRESH.parts([0, 2])
    for part, start in ((first, 0), (third, 80)):
        wanted = [draw("rings", 4, 3, start + k, PROBLEM, "train") for k in range(40)]
        assert np.array_equal(part.initial, [s.initial for s in wanted])
        assert np.array_equal(part.goal, [s.goal for s in wanted])
        assert part.states is None
    (again,) = FRESH.parts()
    assert np.array_equal(again.initial, first.initial)
    assert (len(FRESH), FRESH.n, FRESH.problem) == (40, 3, PROBLEM)


def test_every_epoch_sees_scenarios_that_no_other_has_seen(gentle):
    encoding = fit(FRESH, "line", "offset")
    data = batches(FRESH, Preparation(find(gentle), encoding, torch.device("cpu")))
    order = torch.Generator().manual_seed(0)
    passes = [[b.tensors["ends"] for b in data.shuffled(16, order)] for _ in range(3)]
    assert [len(b) for b in passes[0]] == [16, 16, 8]
    seen = {tuple(one.flatten().tolist()) for part in passes for batch in part for one in batch}
    assert len(seen) == 3 * 40


def test_a_network_learns_without_plans_and_the_best_score_is_kept(gentle):
    before = trained(gentle, epochs=1, learning_rate=1e-12, averaging=0.0)
    after = trained(gentle, epochs=12, source=replace(FRESH, count=400), averaging=0.9)
    scores = [epoch.valid_loss for epoch in after.history]
    assert min(scores) < before.history[0].valid_loss
    assert after.best_epoch == 1 + int(np.argmin(scores))
    told = valid()
    encoding, found = after.model.encoding, find(gentle)
    batch = Preparation(found, encoding, torch.device("cpu")).of(told).tensors
    again = found.score(after.model.network, batch, encoding, recipe_for(gentle, "tuned"))
    assert float(again) == pytest.approx(min(scores), rel=1e-5)


def test_the_same_seed_draws_the_same_scenarios_and_gives_the_same_bits(gentle):
    first, second, other = (trained(gentle, seed=seed) for seed in (3, 3, 4))
    assert torch.equal(weights(first), weights(second))
    assert first.history[-1].valid_loss == second.history[-1].valid_loss
    assert not torch.equal(weights(first), weights(other))


@pytest.mark.parametrize("n", [1, 3, 8])
def test_answered_controls_are_planned_with_for_any_number_of_craft(gentle, n, tmp_path):
    save(trained(gentle).model, tmp_path)
    model = load(tmp_path)
    A, B = cw_matrices(PROBLEM.mean_motion, PROBLEM.time_step)
    asked = scenarios(3, n, "test")
    plans = Flown(model, "gentle").plan(asked)
    answer = model.answer(*ends(asked), PROBLEM.collision_radius)
    for scenario, plan, controls in zip(asked, plans, answer, strict=True):
        after = plan.states[:, :-1] @ A.T + plan.controls @ B.T
        np.testing.assert_allclose(plan.states[:, 1:], after, atol=1e-6)
        np.testing.assert_allclose(plan.states[:, -1], scenario.goal, atol=1e-6)
        np.testing.assert_allclose(
            plan.controls, controls, atol=1e-6 * np.abs(controls).max() + 1e-9
        )
        assert plan.certificate.fuel >= plan.certificate.fuel_lower_bound * (1 - 1e-9)
    flown = model.predict(*ends(asked))
    np.testing.assert_allclose(flown, [plan.states for plan in plans], atol=1e-2)


def test_a_planner_tells_a_network_the_scenario_s_collision_radius(gentle):
    flown = Flown(trained(gentle).model, "gentle")
    near, wide = (
        flown.plan(scenarios(1, problem=replace(PROBLEM, collision_radius=r)))[0]
        for r in (10.0, 20.0)
    )
    again = flown.plan(scenarios(1, problem=replace(PROBLEM, collision_radius=10.0)))[0]
    assert np.array_equal(near.controls, again.controls)
    assert np.abs(near.controls - wide.controls).max() > 1e-9


def test_a_network_that_learns_the_expert_s_plans_refuses_scenarios_without():
    with pytest.raises(InputError, match="no plans of the expert"):
        trained("ff1")
