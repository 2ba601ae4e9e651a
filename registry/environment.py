"""What a run was made with: versions, platform and commit of the code."""

import json
import os
import platform
import subprocess
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

from pipeline.documents import parsed
from pipeline.networks.catalogue import distribution_of
from pipeline.provenance import DecidedBy, made_with, version_change

PACKAGES = ("prolearn", "torch", "numpy", "mlflow")

LOADING = ("prolearn", "mlflow", "numpy", "safetensors", "torch")
"""Packages that a registered model needs to be loaded."""

MADE_WITH = "made_with"
"""Tag with the versions, ours and others', that decide what a run gives, as JSON."""

TRAINED_BY: DecidedBy = (
    tuple(f"pipeline/{part}" for part in ("orbit", "scenario", "networks", "training")),
    ("numpy", "scipy", "numba", "torch"),
)
PLANNING = ("orbit", "scenario", "plan", "expert", "networks", "planners", "flight")
EXPERIMENTS = ("records", "trials", "warmstart", "flights")
JOBS = ("experiments", "held_out", "networks")
EVALUATED_BY: DecidedBy = (
    (
        *(f"pipeline/{part}" for part in PLANNING),
        *(f"pipeline/experiments/{part}.py" for part in EXPERIMENTS),
        *(f"cli/jobs/{job}.py" for job in JOBS),
    ),
    ("numpy", "scipy", "numba", "clarabel", "highspy", "torch"),
)
"""Code of ours and packages that decide what comes of a training, and of an experiment."""


def environment_tags(decided_by: DecidedBy) -> dict[str, str]:
    """Versions, platform and, where the code is in a git checkout, its commit.

    Args:
        decided_by: code of ours and packages that decide what the run gives.
    """
    tags = {MADE_WITH: json.dumps(dict(made_with(*decided_by)), sort_keys=True)}
    tags |= {f"{name}_version": version(name) for name in PACKAGES}
    tags |= {"python_version": platform.python_version(), "platform": platform.platform()}
    tags["cores"] = str(os.cpu_count())
    commit = git_commit()
    return tags | ({"git_commit": commit} if commit else {})


def changed_since(tags: Mapping[str, str], decided_by: DecidedBy) -> str:
    """The first version that differs from those of an earlier run; empty where none does."""
    return version_change(versions_of(tags), made_with(*decided_by))


def versions_of(tags: Mapping[str, str]) -> dict[str, str]:
    """The versions that decided what an earlier run gave; none where it did not say."""
    try:
        found = parsed(tags.get(MADE_WITH, "").encode())
    except ValueError:
        return {}
    plain = isinstance(found, dict) and all(isinstance(value, str) for value in found.values())
    return found if plain else {}


def requirements(arch: str) -> list[str]:
    """Exact requirements of a registered model, without a build's local label (+cpu).

    The distribution that brings the architecture is one of them.
    """
    names = dict.fromkeys((*LOADING, distribution_of(arch) or LOADING[0]))
    return [f"{name}=={version(name).partition('+')[0]}" for name in names]


def git_commit() -> str | None:
    """Commit of the running code, with ``-dirty`` after it where files differ from it."""
    here = Path(__file__).resolve()
    # A package installed inside somebody's checkout is not part of that checkout's history.
    if _git(here, "ls-files", "--error-unmatch", here.name) is None:
        return None
    return _git(here, "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*")


def _git(file: Path, *arguments: str) -> str | None:
    try:
        done = subprocess.run(
            ["git", "-C", str(file.parent), *arguments],
            capture_output=True,
            text=True,
            timeout=10,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip() or None
