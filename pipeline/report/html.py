"""Markdown to one HTML page that needs nothing beside it."""

import base64
import re
from itertools import pairwise
from pathlib import Path

from markdown_it import MarkdownIt
from markdown_it.token import Token
from markupsafe import Markup

from pipeline.exhibits.sections import TEMPLATES


def html_page(title: str, markdown: str, folder: Path) -> str:
    """The page, with the figures that the Markdown names read from ``folder`` and inlined.

    Raw HTML and links in the text stay text: the page refers to nothing outside itself.
    """
    parser = MarkdownIt("commonmark", {"html": False}).enable("table")
    parser.disable(["link", "autolink"])
    tokens = parser.parse(markdown)
    contents = _number_headings(tokens)
    tokens = _wide_tables(_whole_figures(parser, tokens, folder))
    body = parser.renderer.render(tokens, parser.options, {})
    # The body comes out of the parser, which escapes what the text contains.
    return TEMPLATES.get_template("report/page.html.jinja").render(
        title=title, contents=contents, body=Markup(body)
    )


def _number_headings(tokens: list[Token]) -> list[tuple[str, str]]:
    """Give each section heading an id; the ids and titles, in order."""
    contents = []
    for heading, inline in pairwise(tokens):
        if heading.type == "heading_open" and heading.tag == "h2":
            name = re.sub(r"[^a-z0-9]+", "-", inline.content.lower()).strip("-")
            heading.attrSet("id", name)
            contents.append((name, inline.content))
    return contents


def _whole_figures(parser: MarkdownIt, tokens: list[Token], folder: Path) -> list[Token]:
    """Paragraphs that begin with an image become figures, the rest of them the caption."""
    out: list[Token] = []
    skip = 0
    for k, token in enumerate(tokens):
        if skip:
            skip -= 1
            continue
        children = tokens[k + 1].children if token.type == "paragraph_open" else None
        if children and children[0].type == "image":
            out.append(_figure(parser, children, folder))
            skip = 2  # the paragraph's inline and closing tokens
        else:
            out.append(token)
    return out


def _figure(parser: MarkdownIt, children: list[Token], folder: Path) -> Token:
    image, caption = children[0], children[1:]
    data = base64.b64encode((folder / str(image.attrs["src"])).read_bytes()).decode()
    label = Markup.escape(image.content)
    inline = Token("inline", "", 0, children=caption)
    text = str(parser.renderer.render([inline], parser.options, {})).strip()
    figure = (
        f'<figure>\n<img alt="{label}" src="data:image/svg+xml;base64,{data}">\n'
        f"<figcaption>{text}</figcaption>\n</figure>\n"
    )
    return Token("html_block", "", 0, content=figure)


def _wide_tables(tokens: list[Token]) -> list[Token]:
    """Tables in a box of their own that scrolls where the window is narrow."""
    out = []
    for token in tokens:
        if token.type == "table_open":
            box = '<div class="table" role="region" aria-label="table" tabindex="0">\n'
            out.append(Token("html_block", "", 0, content=box))
        out.append(token)
        if token.type == "table_close":
            out.append(Token("html_block", "", 0, content="</div>\n"))
    return out
