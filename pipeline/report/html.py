"""Markdown to one HTML page that needs nothing beside it."""

import base64
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import pairwise
from typing import Any

from markdown_it import MarkdownIt
from markdown_it.rules_inline import StateInline
from markdown_it.token import Token
from markupsafe import Markup

from pipeline.markup import template

TABLE = '<div class="table" role="region" aria-label="table" tabindex="0">\n<table>\n'
"""Tables have a box of their own that scrolls where the window is narrow."""

FIGURE = re.compile(r"!\[(?P<label>[^]]*)\]\((?P<src>[^)]*)\)")


def html_page(title: str, markdown: str, pictures: Mapping[str, bytes]) -> str:
    """The page with its pictures inlined; raw HTML, links and other images stay text."""
    parser = MarkdownIt("commonmark", {"html": False}).enable("table")
    parser.disable(["link", "autolink", "reference"])
    parser.inline.ruler.at("image", _figures(pictures))
    rules: dict[str, Callable[..., str]] = parser.renderer.rules  # type: ignore[attr-defined]
    rules["table_open"] = lambda *_: TABLE
    rules["table_close"] = lambda *_: "</table>\n</div>\n"
    rules["paragraph_open"] = lambda tokens, k, *_: "<figure>\n" if _is_figure(tokens, k) else "<p>"
    rules["paragraph_close"] = lambda tokens, k, *_: (
        "</figcaption>\n</figure>\n" if _is_figure(tokens, k - 2) else "</p>\n"
    )

    def image(tokens: Sequence[Token], k: int, *_: Any) -> str:
        data = base64.b64encode(pictures[str(tokens[k].attrs["src"])]).decode()
        label = Markup.escape(tokens[k].content)
        return f'<img alt="{label}" src="data:image/svg+xml;base64,{data}">\n<figcaption>'

    rules["image"] = image
    tokens = parser.parse(markdown)
    contents = _numbered_headings(tokens)
    body = parser.renderer.render(tokens, parser.options, {})
    # The body comes out of the parser, which escapes what the text contains.
    page = template("pipeline/report/page.html.jinja")
    return page.render(title=title, contents=contents, body=Markup(body))


def _figures(pictures: Collection[str]) -> Callable[[StateInline, bool], bool]:
    """The parser's rule for images: those of a list, each at the beginning of its paragraph."""

    def figure(state: StateInline, silent: bool) -> bool:
        found = FIGURE.match(state.src)
        if state.pos or found is None or found["src"] not in pictures:
            return False
        if not silent:
            token = state.push("image", "img", 0)
            token.content, token.attrs = found["label"], {"src": found["src"]}
        state.pos = found.end()
        return True

    return figure


def _is_figure(tokens: Sequence[Token], k: int) -> bool:
    """Whether a paragraph begins with an image, of which the rest of it is the caption."""
    return any(child.type == "image" for child in (tokens[k + 1].children or ())[:1])


def _numbered_headings(tokens: Sequence[Token]) -> list[tuple[str, str]]:
    """Give each section heading an id; the ids and titles, in order."""
    contents = []
    for heading, inline in pairwise(tokens):
        if heading.type == "heading_open" and heading.tag == "h2":
            title = "".join(part.content for part in inline.children or ())
            name = re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")
            heading.attrSet("id", name)
            contents.append((name, title))
    return contents
