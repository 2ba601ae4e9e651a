"""Versions of packages, and digests of our own code, that results are made with."""

import ast
import hashlib
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from pipeline.errors import InputError

# Patterns of paths beside and in ``pipeline``, and distributions, that a result depends on; where
# ``:MODULE`` follows a distribution's name, a digest of that module's code goes with its version
DecidedBy = tuple[tuple[str, ...], tuple[str, ...]]

_PACKAGES = ("orbit", "scenario", "plan", "expert", "networks", "planners", "flight")
FLIGHT = tuple(f"pipeline/{name}" for name in _PACKAGES)  # code that decides how plans are flown

DOCUMENTED = ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef  # have docstrings
DIGITS = 12  # hexadecimal digits of a code's digest that are shown


@cache
def made_with(parts: tuple[str, ...], packages: tuple[str, ...]) -> Mapping[str, str]:
    """Versions by name of our code, by patterns such as ``pipeline/orbit``, and of packages.

    A digest of the code goes with our version, which does not say whether files were changed.
    """
    found = {"prolearn": f"{version('prolearn')}+code.{code_digest(parts)}"}
    return found | {name: version_of(name) for name in packages}


def version_of(package: str) -> str:
    """The version of a distribution, with a digest of its module's code where one is named."""
    name, _, module = package.partition(":")
    return version(name) + (f"+code.{module_digest(module)}" if module else "")


def module_digest(name: str) -> str:
    """Digest of the code of an importable module, or of all modules of a package."""
    found = find_spec(name)
    places = (found.submodule_search_locations or [found.origin or ""]) if found else []
    return "".join(code_digest((path.name,), path.parent) for path in map(Path, places))


def code_digest(parts: tuple[str, ...], root: Path = Path(__file__).parents[1]) -> str:
    """Digest of what modules, by patterns, do: without comments, docstrings and layout."""
    digest = hashlib.sha256()
    found = [path for part in parts for path in root.glob(part)]
    files = {path for path in found if path.is_file()}
    files |= {file for path in found for kind in ("*.py", "*.c") for file in path.rglob(kind)}
    for path in sorted(files):
        content = _normalized(path.read_bytes())
        digest.update(f"{path.relative_to(root).as_posix()} {len(content)}\n".encode() + content)
    return digest.hexdigest()[:DIGITS]


@cache
def _normalized(source: bytes) -> bytes:
    """The syntax tree of a module as text, cached since a process makes several digests of it."""
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError):  # C, or templates of other people's packages
        return source
    return "\n".join(_tree_lines(tree)).encode()


def _tree_lines(tree: ast.Module) -> Iterator[str]:
    """A syntax tree as lines of text, different for different trees: nodes and fields by level."""
    nodes: list[ast.AST] = [tree]
    for node in nodes:  # which grows by each node's children
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node, clean=False) is not None:
            del node.body[0]
        yield type(node).__name__
        for name in node._fields:
            value = getattr(node, name, None)
            # Absent fields are left out, as later Pythons do.
            if isinstance(value, list) and value:
                yield f"{name}: {len(value)}"
                # In order, as an element may be None: the default of a keyword that has none.
                yield from ("" if isinstance(one, ast.AST) else repr(one) for one in value)
                nodes += (one for one in value if isinstance(one, ast.AST))
            elif isinstance(value, ast.AST):
                yield name
                nodes.append(value)
            elif value is not None and value != []:
                yield f"{name}={value!r}"


def version_change(was: Mapping[str, str], now: Mapping[str, str], then: str = "now it is") -> str:
    """The first version that differs, what it was and what it is now; empty where none does."""
    for name in sorted({*was, *now}):
        if was.get(name) != now.get(name):
            return f"{name} {was.get(name, 'unknown')}, {then} {now.get(name, 'not used')}"
    return ""


def refuse_other_versions(what: str, was: Mapping[str, str], now: Mapping[str, str]) -> None:
    """InputError with the first version that differs; ``what`` as in "data/n10 was solved"."""
    change = version_change(was, now)
    if change:
        raise InputError(
            f"{what} with {change}; expected the same versions, since results of different ones "
            "do not go into one folder: go back to them, give another folder, or remove this one."
        )


def refuse_change(what: str, was: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """Raise InputError, naming the first setting that differs from those of a folder."""
    was, now = dict(_flat(was)), dict(_flat(now))
    for name in sorted({*was, *now}):
        if was.get(name) != now.get(name):
            raise InputError(
                f"{what} was begun with {name} = {was.get(name)}, now it is {now.get(name)}; "
                "expected the same settings: give the old one or another folder."
            )


def _flat(settings: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Settings by their names, those inside others as in ``planner.settings.stop``."""
    for name, value in settings.items():
        if isinstance(value, Mapping) and value:
            yield from _flat(value, f"{above}{name}.")
        else:
            yield f"{above}{name}", value
