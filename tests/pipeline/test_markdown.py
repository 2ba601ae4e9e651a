"""Text from elsewhere against the parser that makes the report's page."""

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from markdown_it import MarkdownIt

from pipeline.markup import Markdown, code, escaped, formatted, table
from pipeline.text import visible

GITHUB = MarkdownIt("commonmark", {"html": True}).enable(["table", "strikethrough"])
"""All that a reader's Markdown may know, raw HTML included."""

MARKUP = st.text(alphabet="*_`~[]()<>!#&;:.|\\-+=1a $\n\t/@'\"{}^", max_size=30)
WORDS = st.sampled_from(
    [
        *(
            "![i](/etc/passwd)",
            "[a](javascript:x)",
            "[a]: /x",
            "[^1]: x",
            "<script>",
            "<!--",
            "<a@b.c>",
        ),
        *(
            "&#x3c;",
            "&lt;",
            "~~x~~",
            "```",
            "~~~ x",
            "- x",
            "1. x",
            "2) x",
            "# x",
            "> x",
            "---",
            "===",
            "***",
        ),
        *(
            "a | b",
            "|---|",
            "\\",
            "\\|",
            "`",
            "`` ` ``",
            "https://x.y",
            "$\\frac$",
            "    x",
            "a  \nb",
        ),
    ]
)
ANY = st.one_of(st.text(), MARKUP, st.lists(st.one_of(WORDS, MARKUP, st.text())).map("".join))


def shown(text):
    """What a reader sees of a text: on one line, without white space at its ends."""
    return " ".join(visible(" ".join(text.split())).split())


def parts_of(markdown, blocks):
    """Kind and content of what is inside the blocks of a document, which has no others."""
    tokens = GITHUB.parse(markdown)
    assert [token.type for token in tokens if token.nesting == 1] == blocks
    inside = [token.children for token in tokens if token.type == "inline"]
    return [[(part.type, part.content) for part in parts] for parts in inside]


def assert_text(parts, wanted):
    assert {kind for kind, _ in parts} <= {"text"}
    assert " ".join("".join(content for _, content in parts).split()) == " ".join(wanted.split())


@given(ANY)
@example("[46.9, 49.1](/x)")
@example("[1, 2]: /x")
@example(" - x")
def test_any_text_is_itself_in_a_paragraph_of_its_own(text):
    (parts,) = parts_of(escaped(text), ["paragraph_open"]) if shown(text) else [[]]
    assert_text(parts, shown(text))


@given(ANY, ANY)
def test_any_text_is_itself_among_words_and_beside_another(one, other):
    (parts,) = parts_of(formatted("of {} and {} here", one, other), ["paragraph_open"])
    assert_text(parts, f"of {shown(one)} and {shown(other)} here")


@given(ANY, ANY)
def test_any_text_is_itself_in_a_heading_and_in_a_list(one, other):
    document = formatted("## {}\n\n- {}\n", f"x {one}", f"x {other}")
    blocks = ["heading_open", "bullet_list_open", "list_item_open", "paragraph_open"]
    for parts, text in zip(parts_of(document, blocks), (one, other), strict=True):
        assert_text(parts, f"x {shown(text)}")


@given(ANY)
def test_any_text_is_itself_in_a_code_span(text):
    (parts,) = parts_of(formatted("of {} here", code(text)), ["paragraph_open"])
    kinds = [kind for kind, _ in parts]
    assert kinds == (["text", "code_inline", "text"] if shown(text) else ["text"])
    assert "".join(content for _, content in parts) == f"of {shown(text)} here"


@given(ANY, ANY, ANY)
def test_any_text_is_itself_in_a_table_as_heading_cell_and_code(head, cell, span):
    rows = [(cell, code(span)), (escaped(cell), "x")]
    blocks = ["table_open", "thead_open", "tr_open", "th_open", "th_open", "tbody_open"]
    found = parts_of(table((head, "y"), rows), blocks + 2 * ["tr_open", "td_open", "td_open"])
    assert_text(found[0], shown(head))
    assert_text(found[2], shown(cell))
    assert_text(found[4], shown(cell))
    assert found[3] == ([("code_inline", shown(span))] if shown(span) else [])


@pytest.mark.parametrize(
    "name",
    [
        *("lstm1:tuned", "n=10", "data/paper", "ff1/3", "1e-5", "-0.5", "+3", "my_net", "Σ‖u‖₁"),
        *("48 % [46.9, 49.1]", "+0.1 [-0.2, +0.4]", "< 0.1 %", "(T-1)·3", "s3://bucket/n10", "R&D"),
        *(
            "prolearn-lstm2@champion",
            "Experiment 3, expert: 1.5 s",
            "2026-01-01 12:00 UTC",
            "a - b",
        ),
    ],
)
def test_ordinary_names_and_numbers_stay_as_they_are(name):
    assert escaped(name) == name
    assert name in table(("",), [(name,)])


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("a\x1b[31m\x07\x9b", r"a\x1b[31m\x07\x9b"),
        ("\u202etxt.exe\u2066\u200b\u00ad\ufeff", r"\u202etxt.exe\u2066\u200b\xad\ufeff"),
        ("\u3164\u2800\U000e0041", r"\u3164\u2800\U000e0041"),
        ("one\ntwo\r\tthree", r"one\ntwo\r\tthree"),
        ("bad\udcff.json", r"bad\udcff.json"),
        ("Größe Δv ‖u‖₁ 中文", "Größe Δv ‖u‖₁ 中文"),
    ],
)
def test_what_cannot_be_seen_is_shown_as_an_escape(text, wanted):
    assert visible(text) == wanted


def test_markdown_stays_as_it_is_and_what_is_made_of_it_is_text_again():
    assert escaped(Markdown("*a*")) == "*a*"
    assert escaped(Markdown("*a*") + "") == r"\*a\*"
