"""Sections: text from templates, with the tables and figures that they call for."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from pipeline.exhibits.blocks import Picture, Table
from pipeline.markdown import Markdown
from pipeline.templates import template


@dataclass(frozen=True, eq=False)
class Section:
    """Text with tables and figures in it.

    A template places them by ``{% call table(x) %}caption{% endcall %}`` and
    ``{% call figure(x) %}caption{% endcall %}``; empty lines part its paragraphs, and other ends
    of lines are as good as spaces.

    Attributes:
        template: its path, as for ``pipeline.templates.template``.
        values: what the template names.
    """

    template: str
    values: Mapping[str, Any]


class Writer:
    """Writes sections, one after another, and numbers their tables and figures.

    Attributes:
        tables: those written, in order.
        pictures: likewise.
    """

    def __init__(self) -> None:
        self.tables: list[Table] = []
        self.pictures: list[Picture] = []

    def write(self, section: Section) -> Markdown:
        """The section's Markdown, each paragraph on a line of its own."""
        given = {**section.values, "table": self._table, "figure": self._figure}
        text = template(section.template).render(given)
        parts = filter(None, map(str.strip, re.split(r"\n\s*\n", text)))
        lines = (p if p.startswith(("|", "!")) else " ".join(p.split()) for p in parts)
        return Markdown("\n\n".join(lines))

    def _table(self, table: Table, caller: Callable[[], str]) -> str:
        self.tables.append(table)
        caption = f"{caller().strip()} {table.signs}".strip()
        return f"*Table {len(self.tables)}. {caption}*\n\n{table.markdown}\n\n"

    def _figure(self, picture: Picture, caller: Callable[[], str]) -> str:
        self.pictures.append(picture)
        k, caption = len(self.pictures), " ".join(caller().split())
        return f"![Figure {k}](figures/{picture.file}.svg)\n*Figure {k}. {caption}*\n\n"
