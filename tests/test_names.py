"""Names: a class or type has one that no other has, in whichever module."""

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("pipeline", "registry", "cli", "prolearn", "benchmarks")


def types_of(module: ast.Module) -> Iterator[str]:
    """Names of the classes and type aliases that a module defines, without type variables."""
    for node in module.body:
        if isinstance(node, ast.ClassDef):
            yield node.name
        if isinstance(node, ast.Assign) and "TypeVar(" not in ast.unparse(node.value):
            yield from (name.id for name in node.targets if is_type_name(name))


def is_type_name(target: ast.expr) -> bool:
    """Whether a name is in CamelCase, as those of types are."""
    if not isinstance(target, ast.Name):
        return False
    return target.id[0].isupper() and any(letter.islower() for letter in target.id)


def test_no_two_modules_give_a_class_or_type_the_same_name():
    places = defaultdict(set)
    for path in (path for package in PACKAGES for path in (ROOT / package).rglob("*.py")):
        for name in types_of(ast.parse(path.read_text(encoding="utf-8"))):
            places[name].add(str(path.relative_to(ROOT)))
    assert len(places) > 300
    assert {name: some for name, some in places.items() if len(some) > 1} == {}
