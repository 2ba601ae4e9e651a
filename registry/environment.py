"""What a run was made with: versions, platform and commit of the code."""

import json
import os
import platform
import subprocess
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path

from pipeline.documents import parse_json, validated
from pipeline.networks.recipes import code_of_others, distribution_of
from pipeline.provenance import FLIGHT, DecidedBy, made_with, version_change

PACKAGES = ("prolearn", "torch", "numpy", "mlflow")
LOADING = ("prolearn", "mlflow", "numpy", "safetensors", "torch")  # packages that load models
MADE_WITH = "made_with"  # tag: the versions of code and packages that decide a run's results, JSON

TRAINED_BY: DecidedBy = (
    tuple(f"pipeline/{part}" for part in ("orbit", "scenario", "networks", "training")),
    ("numpy", "scipy", "torch"),
)
EXPERIMENTS = ("records", "trials", "warmstart", "flights", "example_transfer")
EVALUATED_BY: DecidedBy = (
    (*FLIGHT, *(f"pipeline/experiments/{k}.py" for k in EXPERIMENTS), "cli/jobs/experiments.py"),
    ("numpy", "scipy", "clarabel", "highspy", "torch"),
)
"""Code of ours and packages that decide what comes of a training, and of an experiment."""


def with_architectures(decided_by: DecidedBy, names: Iterable[str]) -> DecidedBy:
    """The code and packages that decide results, third-party architectures among them."""
    parts, packages = decided_by
    return parts, (*packages, *code_of_others(names))


@cache
def environment_tags(decided_by: DecidedBy) -> Mapping[str, str]:
    """Versions of what decides a run, platform and, in a git checkout, the commit of the code.

    A process finds them once, at its first run, since it goes on with the code that it has.
    """
    tags = {
        MADE_WITH: json.dumps(dict(made_with(*decided_by)), sort_keys=True),
        **{f"{name}_version": version(name) for name in PACKAGES},
        "python_version": platform.python_version(),
        "platform": platform.platform(),
        "cores": str(os.cpu_count()),
    }
    commit = git_commit()
    return tags | ({"git_commit": commit} if commit else {})


def changed_since(tags: Mapping[str, str], decided_by: DecidedBy) -> str:
    """The first version that differs from those of an earlier run; empty where none does."""
    return version_change(versions_of(tags), made_with(*decided_by))


def versions_of(tags: Mapping[str, str]) -> dict[str, str]:
    """The versions that decided an earlier run; none where its tags do not say."""
    try:
        return validated(dict[str, str], parse_json(tags.get(MADE_WITH, "").encode()))
    except ValueError:
        return {}


def requirements(arch: str) -> list[str]:
    """Exact requirements of a registered model and its architecture, without +cpu."""
    names = dict.fromkeys((*LOADING, distribution_of(arch) or LOADING[0]))
    return [f"{name}=={version(name).partition('+')[0]}" for name in names]


def git_commit() -> str | None:
    """Commit of the running code, with ``-dirty`` after it where files differ from it."""
    here = Path(__file__).resolve()

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(here.parent), *arguments]
        return subprocess.check_output(command, stderr=subprocess.DEVNULL, text=True, timeout=10)

    try:
        # A package installed inside somebody's checkout is not part of that checkout's history.
        git("ls-files", "--error-unmatch", here.name)
        return git("describe", "--always", "--dirty", "--abbrev=40", "--exclude=*").strip() or None
    except (OSError, subprocess.SubprocessError):
        return None
