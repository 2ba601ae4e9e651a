"""The architectures that docs/architectures.md shows, as a distribution and as objects."""

import re
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType

PAGE = (Path(__file__).parents[2] / "docs" / "architectures.md").read_text(encoding="utf-8")

MODULES = dict(re.findall(r"`(my_\w+)\.py`.*?```python\n(.*?)```", PAGE, re.DOTALL))
"""Source by name of the module."""


def install(site: Path) -> None:
    """Puts them into a folder like site-packages, as pip would."""
    info = site / "their_networks-1.2.dist-info"
    info.mkdir(parents=True)
    for name, source in MODULES.items():
        (site / f"{name}.py").write_text(source, encoding="utf-8")
    entries = PAGE.partition('[project.entry-points."prolearn.architectures"]\n')[2]
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: their-networks\nVersion: 1.2\n")
    (info / "entry_points.txt").write_text(
        "[prolearn.architectures]\n" + entries.partition("```")[0].replace('"', "")
    )


def entry_point(module: str, name: str) -> EntryPoint:
    """An entry point to an object of one of them, made on the spot."""
    made = ModuleType(module)
    exec(MODULES[module], vars(made))

    class Here(EntryPoint):
        def load(self) -> object:
            return getattr(made, name)

    return Here(name.lower(), f"{module}:{name}", "prolearn.architectures")
