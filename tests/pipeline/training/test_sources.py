"""Fresh scenarios without end, and networks that learn from them without the expert."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

from pipeline.dataset.examples import Examples
from pipeline.dataset.making import sample, solve
from pipeline.dataset.samples import Sample
from pipeline.errors import InputError
from pipeline.expert import Settings
from pipeline.networks.architecture import find, recipe_for
from pipeline.networks.encoding import fit
from pipeline.networks.model import load, save
from pipeline.orbit.problem import Problem
from pipeline.parallel.workers import Workers
from pipeline.progress import Progress
from pipeline.scenario import draw
from pipeline.training.data import batches, fresh_draws, prepare, sources
from pipeline.training.loop import train

PROBLEM = Problem(nodes=6)
FRESH = fresh_draws("rings", 4, 3, PROBLEM, 40)


class Counting(Progress):
    """Counts what is drawn."""

    expected = drawn = 0

    def expect(self, total):
        self.expected += total

    def done(self, units=1, note="", *, failed=None):
        self.drawn += units


def scenarios(count, n=3, split="valid"):
    return [draw("rings", 1, n, k, PROBLEM, split) for k in range(count)]


def ends(some):
    """Initial and goal states of scenarios."""
    return [np.stack([getattr(one, end) for one in some]) for end in ("initial", "goal")]


def valid(count=60):
    return Examples(PROBLEM, *ends(scenarios(count)))


def trained(arch, *, seed=0, epochs=3, source=FRESH, **changes):
    recipe = replace(recipe_for(arch, "tuned"), batch_size=16, epochs=epochs, **changes)
    return train(arch, recipe, source, valid(), seed=seed, device="cpu")


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
    data = batches(FRESH, partial(prepare, find(gentle), encoding, torch.device("cpu")))
    order = torch.Generator().manual_seed(0)
    passes = [[b.tensors["ends"] for b in data.shuffled(16, order)] for _ in range(3)]
    assert [len(b) for b in passes[0]] == [16, 16, 8]
    seen = {tuple(one.flatten().tolist()) for part in passes for batch in part for one in batch}
    assert len(seen) == 3 * 40


def test_a_network_learns_without_plans_and_the_best_score_is_kept(gentle):
    before = trained(gentle, epochs=1, learning_rate=1e-12, averaging=0.0)
    after = trained(
        gentle, epochs=12, source=fresh_draws("rings", 4, 3, PROBLEM, 400), averaging=0.9
    )
    scores = [epoch.valid_loss for epoch in after.history]
    assert min(scores) < before.history[0].valid_loss
    assert after.best_epoch == 1 + int(np.argmin(scores))
    told = valid()
    encoding, found = after.model.encoding, find(gentle)
    batch = prepare(found, encoding, torch.device("cpu"), told).tensors
    again = found.score(after.model.network, batch, encoding, recipe_for(gentle, "tuned"))
    assert float(again) == pytest.approx(min(scores), rel=1e-5)


def test_the_same_seed_draws_the_same_scenarios_and_gives_the_same_bits(gentle):
    first, second, other = (trained(gentle, seed=seed) for seed in (3, 3, 4))
    assert torch.equal(weights(first), weights(second))
    assert first.history[-1].valid_loss == second.history[-1].valid_loss
    assert not torch.equal(weights(first), weights(other))


def test_a_network_that_answers_with_controls_is_saved_and_loaded_like_any_other(gentle, tmp_path):
    model = trained(gentle).model
    save(model, tmp_path)
    for n in (1, 3, 8):
        asked = ends(scenarios(4, n, "test"))
        assert np.array_equal(load(tmp_path).answer(*asked, 15.0), model.answer(*asked, 15.0))


def test_a_network_that_learns_the_expert_s_plans_refuses_scenarios_without():
    with pytest.raises(InputError, match="expert's plans, and the scenarios have none"):
        trained("ff1")


@pytest.mark.parametrize("memory", [1e9, 1e4])
def test_crowded_scenarios_are_learned_from_with_those_of_the_dataset(tmp_path, memory):
    """Each of both once a pass, whether the dataset is in memory or streams."""
    solved = tmp_path / "data"
    sample(
        solved,
        {3: Sample(count=20, shares=(0.5, 0.5, 0.0), shard_rows=4)},
        PROBLEM,
        workers=Workers(jobs=1),
    )
    solve(solved, Settings(), workers=Workers(jobs=1))
    recipe = replace(recipe_for("refiner", "tuned"), crowded=7, batch_size=4)
    told = Counting()
    learn, held = sources(recipe, solved, 3, seed=5, memory=memory, progress=told)
    assert (told.expected, told.drawn) == (7, 7)
    plain, _ = sources(replace(recipe, crowded=0), solved, 3, seed=5, memory=memory)
    assert (learn.buffer is None) == (memory == 1e9)
    wanted = [draw("dense", 5, 3, k, held.problem, "train") for k in range(7)]
    known = {tuple(s.initial.ravel()) for s in wanted}
    known |= {tuple(one.ravel()) for part in plain.parts() for one in part.initial}
    assert len(known) == len(learn) == len(plain) + 7
    encoding = fit(learn, "line", "offset")
    ready = partial(prepare, find("refiner"), encoding, torch.device("cpu"))
    order = torch.Generator().manual_seed(0)
    seen = [b.tensors["initial"] for b in batches(learn, ready).shuffled(4, order)]
    assert {tuple(one.numpy().ravel()) for batch in seen for one in batch} == known
    assert sum(len(batch) for batch in seen) == len(known)
    planned = [part.states for part in learn.parts() if part.states is not None]
    assert sum(int(np.isfinite(one).all()) for part in planned for one in part) == len(plain)


def test_a_network_that_learns_in_float64_is_refused_a_device_without_it():
    examples = valid(2)
    encoding = fit(examples, "line", "offset")
    with pytest.raises(InputError, match="device is mps, which has no float64"):
        prepare(find("refiner"), encoding, torch.device("mps"), examples)
