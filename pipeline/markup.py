"""Markdown (CommonMark, GitHub) and Jinja templates that escape the text put into them."""

import re
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any

import jinja2

from pipeline.text import visible


class Markdown(str):
    """Text that is Markdown and is not escaped again; results of its ``str`` methods are."""

    __slots__ = ()


# Characters that may be markup inside a paragraph
_INLINE = re.compile(
    r"""[\\`*~$]                                  # escapes, code, emphasis, strikethrough, formulas
    | \[ (?! [-+0-9.,\ ∞]+ \] (?![\[(:]) )       # links, images, footnotes; no interval is one
    | (?<![^\W_])_ | _(?![^\W_])                  # emphasis, which never begins or ends in a word
    | < (?=[A-Za-z/!?]|$)                         # HTML
    | & (?=\#?\w+;)                               # entities
    | (?<!\S)\#                                   # headings begin and end with it
    | (?i: (?<=http)|(?<=https)|(?<=ftp) ):(?=//) # addresses, which become links by themselves
    | (?i: (?<=www) )\.
    """,
    re.VERBOSE,
)

# What may be a list, a quotation, a rule or a part of a table at the beginning of a paragraph
_BLOCK = re.compile(r"(\ ?)(?:(\d{1,9})(?=[.)](?:\ |$))|(?=[-+](?:\ |$)|>|[-=:|][-=:|\ ]*$))")


def escaped(value: object) -> Markdown:
    """A value as text on one line: what would be markup is escaped; Markdown stays as it is."""
    if isinstance(value, Markdown):
        return value
    text = _inline(value)
    found = _BLOCK.match(text)
    return Markdown(text if found is None else f"{found[0]}\\{text[found.end() :]}")


def code(value: object) -> Markdown:
    """A value as a code span; nothing where it is empty."""
    text = visible(" ".join(str(value).split()))
    if not text:
        return Markdown()
    longest = max(map(len, re.findall("`+", text)), default=0)
    pad = " " if text[0] == "`" or text[-1] == "`" else ""
    fence = "`" * (longest + 1)
    return Markdown(f"{fence}{pad}{text}{pad}{fence}")


def verbatim(value: object) -> Markdown:
    """A value as part of a line in a block of code, where nothing is markup."""
    return Markdown(visible(str(value)))


def formatted(form: str, *values: object) -> Markdown:
    """Markdown with values in the place of ``{}``."""
    return Markdown(form.format(*map(escaped, values)))


def table(
    head: Sequence[object], rows: Iterable[Sequence[object]], right: Collection[int] | None = None
) -> Markdown:
    """A table, with columns ``right`` aligned right and the others left, or as readers like."""
    from tabulate import tabulate  # a light installation has none

    columns = range(len(head))
    sides = None if right is None else ["right" if k in right else "left" for k in columns]
    return Markdown(
        tabulate(
            [list(map(_cell, row)) for row in rows],
            headers=list(map(_cell, head)),
            colalign=sides,
            tablefmt="pipe" if sides else "github",
            disable_numparse=True,
        )
    )


def _cell(value: object) -> str:
    """A cell of a table, where a ``|`` separates cells even in code."""
    return (value if isinstance(value, Markdown) else _inline(value)).replace("|", "\\|")


def _inline(value: object) -> str:
    # White space is kept at both ends, where it may separate words of a template.
    return _INLINE.sub(r"\\\g<0>", visible(re.sub(r"\s+", " ", str(value))))


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
