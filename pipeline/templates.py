"""Jinja templates of HTML and Markdown that escape what they print."""

from pathlib import Path
from typing import Any

import jinja2

from pipeline.markdown import Markdown, code, escaped, verbatim
from pipeline.text import visible


def _visible(value: Any) -> Any:
    """A value before its markup is escaped as HTML; what is HTML already stays as it is."""
    text = isinstance(value, str) and not hasattr(value, "__html__")
    return visible(value) if text else value


_HTML = jinja2.Environment(
    loader=jinja2.FileSystemLoader(Path(__file__).parents[1]),
    autoescape=jinja2.select_autoescape(["html.jinja"]),
    finalize=_visible,
    trim_blocks=True,
    lstrip_blocks=True,
    undefined=jinja2.StrictUndefined,
)

_MARKDOWN = _HTML.overlay(finalize=escaped)
_MARKDOWN.filters = _HTML.filters | {"code": code, "verbatim": verbatim, "markdown": Markdown}


def template(path: str) -> jinja2.Template:
    """A template by its path beside the code that fills it: ``pipeline/report/page.html.jinja``.

    Values that it prints are escaped as HTML or, in a template of Markdown, as Markdown, unless
    they are ``markupsafe.Markup`` or ``Markdown``. In code, where no escape counts, the filters
    ``code`` (a span) and ``verbatim`` (in a block) take their place; the filter ``markdown`` is for
    what the template has set itself.
    """
    environment = _MARKDOWN if path.endswith(".md.jinja") else _HTML
    return environment.get_template(path)
