"""Text that is no text where somebody takes it for markup, and what a reader must see of it."""

import re

from markdown_it import MarkdownIt

HOSTILE = (
    "![i](/etc/passwd) <img src=x onerror=alert(1)> [a](javascript:alert(1)) <!-- &lt; &#x3c; "
    "*b* _c_ ~~d~~ `e` ``f`` a|b $\\frac$ [bold]g[/bold] [link=x.y]h[/link] :smile: "
    "\x1b[31mred \x1b]8;;x.y\x07 \x9b2J \u202eesrever\u2066 \u200b\u00ad\n# i\r\n- j\tk"
)

SEEN = (
    "![i](/etc/passwd) <img src=x onerror=alert(1)> [a](javascript:alert(1)) <!-- &lt; &#x3c; "
    "*b* _c_ ~~d~~ `e` ``f`` a|b $\\frac$ [bold]g[/bold] [link=x.y]h[/link] :smile: "
    r"\x1b[31mred \x1b]8;;x.y\x07 \x9b2J \u202eesrever\u2066 \u200b\xad\n# i\r\n- j\tk"
)
"""Of it in a terminal, by hand."""

READ = SEEN.replace(r"\n", " ").replace(r"\r ", " ").replace(r"\t", " ")
"""Of it in Markdown, where white space is a space."""

NAME = "![i](..) [bold]\x1b[31m$\\frac$ \x9b\u202e|`"
"""A part of it that a file can be called."""

SEEN_NAME = r"![i](..) [bold]\x1b[31m$\frac$ \x9b\u202e|`"

READER = MarkdownIt("commonmark", {"html": True}).enable(["table", "strikethrough"])
"""All that a reader's Markdown may know, raw HTML included."""


def assert_plain(*outputs: str) -> None:
    """No character but ends of lines does anything to a terminal, or to how a text is read."""
    for output in outputs:
        found = {c for c in output if not c.isprintable()} - {"\n"}
        assert not found, found


def read(markdown: str) -> str:
    """What a reader sees of Markdown, which has text, code, emphasis and tables and no more."""
    known = {"text", "code_inline", "softbreak", "em_open", "em_close", "strong_open"}
    known |= {"strong_close"}
    blocks = {"heading", "paragraph", "bullet_list", "list_item", "fence", "inline", "hr"}
    blocks |= {"table", "thead", "tbody", "tr", "th", "td"}
    seen = []
    for token in READER.parse(markdown):
        assert re.sub("_(open|close)$", "", token.type) in blocks, token
        for part in token.children or ():
            assert part.type in known, part
            seen.append(part.content)
        seen.append("\n" + token.content * (token.type == "fence"))
    return "".join(seen)
