"""Conversion of Markdown to one self-contained HTML page."""

import base64
import re
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise

from markdown_it import MarkdownIt
from markdown_it.token import Token
from markupsafe import Markup

from pipeline.markup import template

TABLE = '<div class="table" role="region" aria-label="table" tabindex="0">\n<table>\n'
"""The opening of a table, in a box that scrolls where the window is narrow."""

FIGURE = re.compile(r"!\[(?P<label>[^]]*)\]\((?P<src>[^)]*)\)")
"""The beginning of a paragraph that is a figure; the rest of it is the caption."""

FIGURE_HTML = Markup(
    '<figure>\n<img alt="{label}" src="data:image/svg+xml;base64,{data}">\n'
    "<figcaption>{caption}</figcaption>\n</figure>\n"
)


def html_page(title: str, markdown: str, pictures: Mapping[str, bytes]) -> str:
    """The page with its pictures inlined; raw HTML, links and other images stay text."""
    parser = MarkdownIt("commonmark", {"html": False}).enable("table")
    parser.disable(["link", "autolink", "image", "reference"])
    rules: dict[str, Callable[..., str]] = parser.renderer.rules  # type: ignore[attr-defined]
    rules["table_open"] = lambda *_: TABLE
    rules["table_close"] = lambda *_: "</table>\n</div>\n"
    tokens = parser.parse(markdown)
    for opened, inline, closed in zip(tokens, tokens[1:], tokens[2:], strict=False):
        opened.hidden = False  # items of lists are paragraphs of the same width as others
        found = FIGURE.match(inline.content) if opened.type == "paragraph_open" else None
        if found and found["src"] in pictures:
            caption = Markup(parser.renderInline(inline.content[found.end() :]))
            data = base64.b64encode(pictures[found["src"]]).decode()
            opened.type = inline.type = closed.type = "html_block"
            inline.content = FIGURE_HTML.format(label=found["label"], data=data, caption=caption)
    contents = _heading_ids(tokens)
    body = parser.renderer.render(tokens, parser.options, {})
    # The body comes out of the parser, which escapes what the text contains.
    page = template("pipeline/report/page.html.jinja")
    return page.render(title=title, contents=contents, body=Markup(body))


def _heading_ids(tokens: Sequence[Token]) -> list[tuple[str, str]]:
    """Give each section heading an id, and return ids and titles in order."""
    contents = []
    for heading, inline in pairwise(tokens):
        if heading.type == "heading_open" and heading.tag == "h2":
            title = "".join(part.content for part in inline.children or ())
            name = re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")
            heading.attrSet("id", name)
            contents.append((name, title))
    return contents
