"""Markdown to one HTML page that needs nothing beside it."""

import base64
import re
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from markdown_it import MarkdownIt
from markdown_it.token import Token
from markupsafe import Markup

from pipeline.templates import TEMPLATES

TABLE = '<div class="table" role="region" aria-label="table" tabindex="0">\n<table>\n'
"""Tables have a box of their own that scrolls where the window is narrow."""


def html_page(title: str, markdown: str, folder: Path) -> str:
    """The page, with the figures that the Markdown names read from ``folder`` and inlined.

    Raw HTML and links in the text stay text: the page refers to nothing outside itself.
    """
    parser = MarkdownIt("commonmark", {"html": False}).enable("table")
    parser.disable(["link", "autolink"])
    rules: dict[str, Callable[..., str]] = parser.renderer.rules  # type: ignore[attr-defined]
    rules["table_open"] = lambda *_: TABLE
    rules["table_close"] = lambda *_: "</table>\n</div>\n"
    rules["paragraph_open"] = lambda tokens, k, *_: "<figure>\n" if _is_figure(tokens, k) else "<p>"
    rules["paragraph_close"] = lambda tokens, k, *_: (
        "</figcaption>\n</figure>\n" if _is_figure(tokens, k - 2) else "</p>\n"
    )

    def image(tokens: Sequence[Token], k: int, *_: Any) -> str:
        data = base64.b64encode((folder / str(tokens[k].attrs["src"])).read_bytes()).decode()
        label = Markup.escape(tokens[k].content)
        return f'<img alt="{label}" src="data:image/svg+xml;base64,{data}">\n<figcaption>'

    rules["image"] = image
    tokens = parser.parse(markdown)
    contents = _numbered_headings(tokens)
    body = parser.renderer.render(tokens, parser.options, {})
    # The body comes out of the parser, which escapes what the text contains.
    return TEMPLATES.get_template("pipeline/report/page.html.jinja").render(
        title=title, contents=contents, body=Markup(body)
    )


def _is_figure(tokens: Sequence[Token], k: int) -> bool:
    """Whether a paragraph begins with an image, of which the rest of it is the caption."""
    return any(child.type == "image" for child in (tokens[k + 1].children or ())[:1])


def _numbered_headings(tokens: Sequence[Token]) -> list[tuple[str, str]]:
    """Give each section heading an id; the ids and titles, in order."""
    contents = []
    for heading, inline in pairwise(tokens):
        if heading.type == "heading_open" and heading.tag == "h2":
            name = re.sub(r"[^a-z0-9]+", "-", inline.content.lower()).strip("-")
            heading.attrSet("id", name)
            contents.append((name, inline.content))
    return contents
