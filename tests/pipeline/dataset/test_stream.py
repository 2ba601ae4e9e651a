"""Training data that streams: every instance once, shuffled, in bounded memory."""

import json
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import torch

from pipeline.dataset.examples import ExampleStream
from pipeline.dataset.manifest import recorded
from pipeline.dataset.reading import COPIES, solved_examples
from pipeline.dataset.samples import Sample
from pipeline.dataset.schema import SOLVED_FIELDS, metadata
from pipeline.errors import InputError
from pipeline.expert import Settings
from pipeline.networks.architecture import find, recipe_for
from pipeline.networks.encoding import fit
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import fly, minimum_energy
from pipeline.plan.requirements import AT_ALL_TIMES
from pipeline.storage import MANIFEST
from pipeline.storage.shards import digest_of, encode
from pipeline.training.data import batches, prepare
from pipeline.training.loop import train

CPU = torch.device("cpu")


def write_dataset(folder, n, one, problem=None):
    """A dataset of minimum-energy transfers, one in ten of them without a plan."""
    problem = problem or Problem()
    rng = np.random.default_rng(0)
    meta = metadata(
        problem, {"seed": one.seed, "family": one.family} | recorded(Settings(), AT_ALL_TIMES), {}
    )
    digests = {}
    for shard in range(one.shards):
        rows = one.rows(shard)
        initial, goal = rng.normal(size=(2, len(rows), n, 6)) * np.repeat([100.0, 0.1], 3)
        states = fly(initial, minimum_energy(initial, goal, problem), problem)
        solved = [k % 10 != 3 for k in rows]
        columns = {
            "scenario_id": [f"row-{k}" for k in rows],
            "n_spacecraft": [n] * len(rows),
            "family": ["rings"] * len(rows),
            "split": [split for split, _ in one.drawn_as(rows)],
            "initial": list(initial.reshape(len(rows), -1)),
            "goal": list(goal.reshape(len(rows), -1)),
            "status": ["solved" if ok else "unsolved" for ok in solved],
            "states": [s.ravel() if ok else None for s, ok in zip(states, solved, strict=True)],
        }
        arrays = [pa.array(columns.get(f.name, [None] * len(rows)), f.type) for f in SOLVED_FIELDS]
        table = pa.Table.from_arrays(arrays, schema=pa.schema(SOLVED_FIELDS, metadata=meta))
        name = f"n={n}/part-{shard:05d}.parquet"
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(encode(table))
        digests[name] = digest_of((folder / name).read_bytes())
    document = {
        "schema": "prolearn.dataset/2",
        "problem": problem.document(),
        "samples": {str(n): asdict(one)},
        "solve": recorded(Settings(), AT_ALL_TIMES),
        "made_with": {"sample": {}, "solve": {}},
        "shards": digests,
    }
    (folder / MANIFEST).write_text(json.dumps(document))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stream")
    write_dataset(folder, 3, Sample(count=400, shard_rows=30))
    return folder


def instance_bytes(n):
    """Of the ends and the states of n craft, in doubles."""
    return 8 * n * 6 * (2 + Problem().nodes)


def streamed(folder, split="train", held=50):
    memory = float(COPIES) * held * instance_bytes(3)
    return solved_examples(folder, 3, split, memory)


def test_a_small_dataset_is_loaded_once_and_a_large_one_streams(folder):
    assert len(solved_examples(folder, 3, "train")) == 288
    assert solved_examples(folder, 3, "train").buffer is None
    found = streamed(folder)
    assert isinstance(found, ExampleStream)
    assert (found.buffer, len(found), found.n, found.problem) == (50, 288, 3, Problem())
    assert [len(part) for part in found.parts()][:2] == [27, 27]


def test_a_stream_has_the_instances_of_the_whole_in_order(folder):
    whole, parts = solved_examples(folder, 3, "valid"), list(streamed(folder, "valid", 5).parts())
    assert len(parts) > 1
    for field in ("initial", "goal", "states"):
        joined = np.concatenate([getattr(part, field) for part in parts])
        assert np.array_equal(joined, getattr(whole, field))


def test_scales_of_a_stream_are_those_of_the_whole(folder):
    for target in ("states", "offset"):
        whole = fit(solved_examples(folder, 3, "train"), "line", target)
        parts = fit(streamed(folder), "line", target)
        assert parts.input_scale == pytest.approx(whole.input_scale, rel=1e-12)
        assert parts.target_scale == pytest.approx(whole.target_scale, rel=1e-12)


def preparation(encoding):
    return partial(prepare, find("ff1"), encoding, CPU)


def passed(folder, seed, size=16, held=50):
    encoding = fit(solved_examples(folder, 3, "train"), "line", "states")
    data = batches(streamed(folder, held=held), preparation(encoding))
    return list(data.shuffled(size, torch.Generator().manual_seed(seed)))


def keys(batch):
    return [float(x) for x in batch.tensors["inputs"][:, 0, 0, 0]]


def test_each_pass_over_a_stream_gives_every_instance_once_with_its_own_target(folder):
    whole = solved_examples(folder, 3, "train")
    want = preparation(fit(whole, "line", "states"))(whole)
    of = dict(zip(keys(want), want.tensors["target"], strict=True))
    seen = passed(folder, 0)
    assert sorted(key for batch in seen for key in keys(batch)) == sorted(of)
    assert all(
        torch.equal(of[key], target)
        for batch in seen
        for key, target in zip(keys(batch), batch.tensors["target"], strict=True)
    )
    assert all(len(batch) == 16 for batch in seen[:-1])


def test_a_stream_is_shuffled_across_shards_by_its_seed_alone(folder):
    first, again, other = (list(map(keys, passed(folder, seed))) for seed in (1, 1, 2))
    assert first == again
    assert first != other
    shard, encoding = {}, fit(solved_examples(folder, 3, "train"), "line", "states")
    for k, part in enumerate(streamed(folder).parts()):
        shard.update(dict.fromkeys(keys(preparation(encoding)(part)), k))
    mixed = [len({shard[key] for key in batch}) for batch in first]
    assert np.mean(mixed) >= 2  # a batch draws from several shards, as the buffer holds some


def test_networks_learn_as_well_from_a_stream_as_from_memory(folder):
    recipe, losses = replace(recipe_for("ff1", "tuned"), epochs=8), []
    for train_on, valid, mixed in (
        (solved_examples(folder, 3, "train"), solved_examples(folder, 3, "valid"), None),
        (streamed(folder), streamed(folder, "valid", 5), streamed(folder).buffer),
    ):
        trained = train("ff1", recipe, train_on, valid, device="cpu")
        assert trained.shuffle_buffer == mixed
        losses.append([epoch.valid_loss for epoch in trained.history])
    whole, stream = losses
    assert stream[-1] < 0.95 * stream[0]
    assert stream[-1] == pytest.approx(whole[-1], rel=0.05)


def test_memory_that_is_none_is_refused(folder):
    with pytest.raises(InputError, match="memory is 0"):
        solved_examples(folder, 3, "train", 0.0)


TRAIN = """
import os, sys
from dataclasses import replace
from pathlib import Path
import torch
from pipeline.dataset.reading import solved_examples
from pipeline.training.loop import train
from pipeline.networks.architecture import recipe_for
torch.set_num_threads(1)
folder = sys.argv[1]
def run(split_size, memory):
    data = [solved_examples(folder, n, s, memory) for n, s in split_size]
    train("ff1", replace(recipe_for("ff1", "tuned"), epochs=1), *data, device="cpu")
def peak():
    (line,) = [x for x in Path("/proc/self/status").read_text().splitlines() if "VmHWM" in x]
    return int(line.split()[1]) * 1024
for memory in map(float, sys.argv[2:]):
    if child := os.fork():
        assert os.waitpid(child, 0)[1] == 0
        continue
    run([(10, "valid"), (10, "valid")], 15e6)  # what a short stream needs, weights and all
    before = peak()
    run([(10, "train"), (10, "valid")], memory)
    print(peak() - before, flush=True)
    os._exit(0)
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="reads the peak in /proc")
def test_the_memory_that_training_takes_is_bounded_by_what_it_is_given(tmp_path, forked):
    one = Sample(count=5000, shares=(0.88, 0.12, 0.0), shard_rows=100)
    write_dataset(tmp_path, 10, one)
    size = 4400 * instance_bytes(10)
    assert size > 27e6
    run = forked.run([str(tmp_path), "2e9", "15e6"], tmp_path, code=TRAIN)
    assert run.returncode == 0, run.stderr
    whole, bounded = map(int, run.stdout.split())
    assert whole > 2 * size
    assert bounded < whole / 4  # torch's own buffers vary by some 20 MB
