"""Where the rows of a dataset come from: how they were drawn, and what draws them again."""

import shlex
from collections.abc import Iterator, Sequence

from pipeline.dataset.format.manifest import Manifest
from pipeline.dataset.format.samples import Sample
from pipeline.dataset.format.solving import recorded
from pipeline.dataset.stages.presets import PRESETS
from pipeline.expert import Settings
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import MU_EARTH, R_EARTH, mean_motion_at
from pipeline.plan import AT_ALL_TIMES
from pipeline.scenario.families import FAMILIES

TYPED_DIGITS = range(-3, 7)
"""Decimals that a person may have typed of an altitude in m."""


def drawn_alike(manifest: Manifest) -> list[tuple[list[int], Sample]]:
    """Each way in which scenarios were drawn, with the swarm sizes that were."""
    samples = sorted(manifest.samples.items())
    ways = list(dict.fromkeys(sample for _, sample in samples))
    return [([n for n, sample in samples if sample == way], way) for way in ways]


def described(family: str) -> str:
    """A family of scenarios in a sentence."""
    if family not in FAMILIES:
        return "Of another version of prolearn."
    told = (FAMILIES[family].__doc__ or "").partition("\n")[0]
    return told.replace(" (the default)", "")


def preset_of(manifest: Manifest) -> str | None:
    """The preset that all of it is of, or None; sizes may be missing."""
    # Settings that are newer than the dataset have the value that the expert had built in.
    usual = manifest.solve.items() <= recorded(Settings(), AT_ALL_TIMES).items()
    if not usual or manifest.problem != Problem():
        return None
    for name, samples in PRESETS.items():
        if manifest.samples.items() <= samples.items():
            return name
    return None


def commands(manifest: Manifest, folder: str) -> Iterator[str]:
    """The command lines that make the same rows in a folder.

    Settings of the expert that no option sets are not in them.
    """
    preset = preset_of(manifest)
    if preset:
        yield f"prolearn dataset --preset {preset} --out {folder}"
        return
    for n, sample in sorted(manifest.samples.items()):
        options = " ".join(_options(sample, manifest.problem))
        yield f"prolearn sample --n {n} {options} --out {folder}"
    chosen = {name: str(manifest.solve[name]) for name in ("separation", "solver")}
    how = " ".join(f"--{name} {shlex.quote(value)}" for name, value in chosen.items())
    yield f"prolearn solve {folder} {how}"


def altitude_of(mean_motion: float) -> float:
    """Altitude in m that a mean motion in rad/s belongs to, as short as it can be told."""
    exact = float((MU_EARTH / mean_motion**2) ** (1 / 3) - R_EARTH)
    told = (round(exact, digits) for digits in TYPED_DIGITS)
    return next((one for one in told if mean_motion_at(one) == mean_motion), exact)


def ranges(numbers: Sequence[int]) -> str:
    """Ascending numbers in words.

    >>> ranges([2, 3, 4, 10, 60])
    '2 to 4, 10, 60'
    """
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    told = [f"{run[0]} to {run[-1]}" if len(run) > 1 else str(run[0]) for run in runs]
    return ", ".join(told)


def _options(sample: Sample, problem: Problem) -> Iterator[str]:
    yield f"--count {sample.count} --seed {sample.seed} --family {shlex.quote(sample.family)}"
    yield f"--shares {','.join(map(str, sample.shares))}"
    yield f"--altitude {altitude_of(problem.mean_motion)} --time-step {problem.time_step}"
    yield f"--nodes {problem.nodes} --collision-radius {problem.collision_radius}"
    if problem.max_acceleration is not None:
        yield f"--max-acceleration {problem.max_acceleration}"
