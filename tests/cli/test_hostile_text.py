"""Names of files, planners and messages in them are text in a terminal, a page and other files."""

import json
from html.parser import HTMLParser

import pytest
from hostile import HOSTILE, NAME, SEEN, SEEN_NAME, assert_plain

from cli.output import echo, print_json
from cli.progress import progress
from pipeline.orbit.problem import Problem
from pipeline.scenario import draw
from pipeline.scenario.document import write_scenario


@pytest.fixture
def scenario(tmp_path):
    path = tmp_path / f"{NAME}.json"
    write_scenario(path, draw("rings", 0, 3, 0, Problem()))
    return path.name


@pytest.fixture
def plan(prolearn, scenario, tmp_path):
    """A plan's file, whose planner and message are no text."""
    assert prolearn("plan", scenario, "--out", "p.json").returncode == 0
    document = json.loads((tmp_path / "p.json").read_text())
    document |= {"planner": HOSTILE, "status": "unsafe", "message": HOSTILE}
    (tmp_path / f"{NAME}.plan.json").write_text(json.dumps(document))
    return f"{NAME}.plan.json"


def said(done, status=0):
    """All that a command says, with nothing in it that a terminal obeys."""
    assert done.returncode == status, done.stderr
    assert_plain(done.stdout, done.stderr)
    return done.stdout + done.stderr


@pytest.mark.parametrize(
    "command", ["scenario check", "plan --out .", "tradeoff --duration 1200..1440s"]
)
def test_commands_show_the_name_of_a_scenario_as_it_is(prolearn, scenario, command):
    assert SEEN_NAME in said(prolearn(*command.split(), scenario))


def test_the_figure_of_a_trade_off_has_the_name_as_it_is(prolearn, scenario, tmp_path):
    said(prolearn("tradeoff", scenario, "--duration", "1200..1440s", "--out", "o"))
    drawn = (tmp_path / "o/tradeoff.svg").read_text(encoding="utf-8")
    assert f"<!-- {SEEN_NAME}: n = 3" in drawn


def test_commands_show_what_a_plan_says_as_it_is(prolearn, plan):
    shown = said(prolearn("show", plan, "--out", "p.html"))
    assert shown.count(SEEN) == 2, "the planner, and the message"
    assert SEEN in said(prolearn("convert", plan, "--to", "csv", "--out", "p.csv"), 1)
    said(prolearn("fly", plan, "--eccentricity", 0, "--no-j2"))


def test_flights_are_about_the_name_as_it_is(prolearn, plan, tmp_path):
    said(prolearn("fly", plan, "--trials", 2, "--jobs", 1, "--out", "o"))
    drawn = (tmp_path / "o/trials.svg").read_text(encoding="utf-8")
    assert SEEN_NAME in drawn


def test_errors_show_what_they_quote_as_it_is(prolearn, tmp_path):
    for command, schema in (
        ("show", "plan/2"),
        ("fly", "plan/2"),
        ("scenario check", "scenario/1"),
    ):
        fields = {"schema": f"prolearn.{schema}", HOSTILE: 1}
        (tmp_path / f"{NAME}.json").write_text(json.dumps(fields))
        text = said(prolearn(*command.split(), f"{NAME}.json"), 2)
        assert text.count("\n") == 1 and SEEN_NAME in text and SEEN in text
    assert "gone\\x1b[31m.json" in said(prolearn("show", "gone\x1b[31m.json"), 2)
    assert "other\\x1b[31m" in said_of_usage(prolearn("show", "a.json", "other\x1b[31m"))


def said_of_usage(done):
    """What Typer says of wrong arguments, in a box of its own."""
    assert done.returncode == 2
    assert "\x1b" not in done.stderr
    return done.stderr


def test_a_name_that_is_no_unicode_is_shown(prolearn, tmp_path):
    name = b"bad\xff.json".decode(errors="surrogateescape")
    assert "bad\\udcff.json" in said(prolearn("show", name), 2)
    write_scenario(tmp_path / name, draw("rings", 0, 3, 0, Problem()))
    assert "bad\\udcff.json: 3 craft" in said(prolearn("scenario", "check", name))
    for command in (["scenario", "check"], ["plan", "--out", "."]):
        json.loads(said(prolearn(*command, name, "--json")))


class Page(HTMLParser):
    """The tags of a page, and its text outside of scripts."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.text = ["html"], ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)

    def handle_data(self, data):
        self.text += data if self.tags[-1] not in ("script", "style") else ""


def test_a_page_has_names_and_messages_as_they_are(prolearn, plan, tmp_path):
    said(prolearn("show", plan, "--out", "p.html"))
    page = Page((tmp_path / "p.html").read_text(encoding="utf-8"))
    assert page.text.count(SEEN) >= 4, "title, heading, verdict and table"
    assert page.text.count(SEEN_NAME) == 2
    assert not {"img", "a"} & set(page.tags)
    assert_plain(page.text.replace("\t", " "))


def test_json_has_the_text_and_nothing_that_a_terminal_obeys(capsys):
    document = {"a": [HOSTILE, "\x7f \U000e0041 \udcff"], NAME: "Größe, m/s²"}
    print_json(document)
    printed = capsys.readouterr().out
    assert_plain(printed)
    assert json.loads(printed) == document
    assert "Größe, m/s²" in printed


def test_progress_shows_notes_as_they_are(monkeypatch, capsys):
    monkeypatch.setattr("cli.progress.LINE_SECONDS", 0.0)
    with progress(HOSTILE) as shown:
        shown.expect(2)
        shown.done(note=HOSTILE)
        shown.say(HOSTILE)
        shown.end(HOSTILE)
    printed = capsys.readouterr().err
    assert_plain(printed)
    assert printed.count(SEEN) == 5


def test_a_bar_on_a_terminal_shows_notes_as_they_are(monkeypatch, capsys):
    for name, value in {"COLUMNS": "1500", "FORCE_COLOR": "1", "TERM": "xterm"}.items():
        monkeypatch.setenv(name, value)
    with progress(HOSTILE) as shown:
        shown.expect(2)
        shown.done(note=HOSTILE)
    printed = capsys.readouterr().err
    assert printed.count(SEEN) >= 2
    assert not {"\x9b", "\u202e", "\x07"} & set(printed)


def test_lines_are_lines_of_ours(capsys):
    echo("one", "", "two\nthree", err=True)
    assert capsys.readouterr().err == "one\n\ntwo\\nthree\n"
