"""What a dataset was begun with: the same settings and versions go on with it, others are refused.

All that decides the bytes of a dataset is in its manifest, and so in each shard's ``about``.
"""

from collections.abc import Mapping
from typing import Any

from pipeline.dataset.storage.manifest import Manifest
from pipeline.errors import InputError, ProlearnError
from pipeline.expert import Settings
from pipeline.provenance import DecidedBy, made_with, refuse_other_versions, version_change

SAMPLED_BY: DecidedBy = ("orbit", "scenario"), ("numpy", "scipy", "pyarrow")
"""Code of ours and packages that the bytes of scenarios depend on."""


def solved_by(settings: Settings) -> DecidedBy:
    """Code of ours and packages that the bytes of plans depend on."""
    readable = ("cvxpy",) if settings.solver == "cvxpy" else ()
    packages = ("numpy", "scipy", "pyarrow", "clarabel", "highspy", *readable)
    return ("orbit", "scenario", "plan", "expert"), packages


def refuse_change(what: str, was: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """Refuse to go on with other settings than a folder was begun with.

    Raises:
        InputError: naming the first setting that differs, what it was and what it is now.
    """
    for name in sorted({*was, *now}):
        if was.get(name) != now.get(name):
            raise InputError(
                f"{what} was begun with {name} = {was.get(name)}, now it is {now.get(name)}; "
                "expected the same settings: give the old one or another folder."
            )


def refuse_versions(what: object, manifest: Manifest) -> None:
    """Refuse to go on with a dataset that other versions have begun.

    Raises:
        InputError: naming the first version that differs.
    """
    made = manifest.made_with
    refuse_other_versions(f"{what} was sampled", made.sample, made_with(*SAMPLED_BY))
    if manifest.solve:
        versions = made_with(*solved_by(Settings(**manifest.solve)))
        refuse_other_versions(f"{what} was solved", made.solve, versions)


def check_worker(expected: Mapping[str, str], decided_by: DecidedBy) -> None:
    """Refuse to work on a shard with other versions than the process that asked for it has.

    Raises:
        ProlearnError: naming the first version that differs.
    """
    change = version_change(expected, made_with(*decided_by))
    if change:
        raise ProlearnError(
            f"the dataset is made with {change} on a worker; expected the same versions on all "
            "machines: install them there and run the same command again."
        )
