"""Text from Jinja templates, which lie beside the code that fills them."""

from collections.abc import Iterable, Sequence
from typing import Any

import jinja2
from tabulate import tabulate


def render(package: str, template: str, *, html: bool = False, **values: Any) -> str:
    """A template of a package with its values; a value that is missing is an error.

    Args:
        package: where the template lies, such as "pipeline.report".
        template: its file.
        html: escape what the values contain.
        values: what the template names.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader(package, ""),
        autoescape=html,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
    )
    return environment.get_template(template).render(values)


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A Markdown table whose cells stand as they are given."""
    return tabulate(list(rows), head, tablefmt="github", disable_numparse=True)
