"""The datasets that the experiments need, by name."""

from pipeline.dataset.format.samples import Sample

ONLY_TEST = (0.0, 0.0, 1.0)
EVALUATED = range(2, 31)
"""Swarm sizes of experiment 2."""

BEYOND = {
    60: Sample(count=50, shares=ONLY_TEST, shard_rows=10),
    100: Sample(count=50, shares=ONLY_TEST, shard_rows=10),
    300: Sample(count=10, shares=ONLY_TEST, shard_rows=2),
}
"""Swarms beyond the paper's; their rings grow with n, so that craft stay as dense as at n=30."""

TRAINED = 10
"""Swarm size that the paper trains on."""

PRESETS: dict[str, dict[int, Sample]] = {
    "demo": {
        **{n: Sample(count=20, shares=ONLY_TEST, shard_rows=10) for n in (2, 5, 15, 20, 30)},
        60: Sample(count=10, shares=ONLY_TEST, shard_rows=5),
        TRAINED: Sample(count=1250, shares=(0.8, 0.12, 0.08), shard_rows=125),
    },
    "paper": {
        **{n: Sample(count=100, shares=ONLY_TEST, shard_rows=25) for n in EVALUATED},
        TRAINED: Sample(count=10_000, shares=(0.8, 0.1, 0.1), shard_rows=250),
        **BEYOND,
    },
}
"""By preset and swarm size; ``paper`` is 8000 + 1000 + 1000 at n=10, 100 trials at every other n up
to 30, and BEYOND."""
