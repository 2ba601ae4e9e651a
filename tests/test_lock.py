"""The locked versions fit pyproject.toml, one another and the oldest Python that it promises."""

import tomllib
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
LOCKS = {"run": (), "test": ("dev", "onnx", "tune"), "docs": ("docs",)}
OLDEST = "3.11.2"


def locked(name, python):
    """Versions by package, as one lock has them for a Python."""
    found = {}
    for line in (ROOT / name).read_text(encoding="utf-8").splitlines():
        if line and not line.startswith("#"):
            one = Requirement(line)
            if one.marker is None or one.marker.evaluate({"python_full_version": python}):
                (version,) = one.specifier
                found[canonicalize_name(one.name)] = version.version
    return found


@pytest.mark.parametrize("lock", LOCKS)
def test_a_lock_has_all_that_is_asked_for_in_versions_that_are_asked_for(lock):
    found = locked(f"requirements/{lock}.txt", OLDEST)
    extras = PROJECT["optional-dependencies"]
    asked = [*PROJECT["dependencies"], *(line for extra in LOCKS[lock] for line in extras[extra])]
    for one in map(Requirement, asked):
        if one.name != "prolearn":
            assert found[canonicalize_name(one.name)] in one.specifier, one
    assert found["torch"] == "2.13.0"


@pytest.mark.parametrize("lock", LOCKS)
def test_a_lock_takes_its_versions_from_the_constraints(lock):
    assert (
        locked(f"requirements/{lock}.txt", OLDEST).items()
        <= locked("constraints.txt", OLDEST).items()
    )


def test_every_version_for_the_oldest_python_runs_on_it():
    refused, seen = {}, 0
    for name, version in locked("constraints.txt", OLDEST).items():
        try:
            known = metadata(name)
        except PackageNotFoundError:
            continue
        if known["Version"].partition("+")[0] == version:
            seen += 1
            if not SpecifierSet(known.get("Requires-Python") or "").contains(OLDEST):
                refused[name] = known.get("Requires-Python")
    assert seen > 100
    assert refused == {}
