from collections.abc import Iterator

import documented
import pytest

from pipeline.networks import architecture, recipes


@pytest.fixture
def gentle(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The documented architecture that learns without plans, by its name."""
    known = recipes.entry_point
    here = documented.entry_point("my_controls", "GENTLE")
    monkeypatch.setattr(
        architecture, "entry_point", lambda name: here if name == "gentle" else known(name)
    )
    architecture.find.cache_clear()
    yield "gentle"
    architecture.find.cache_clear()
