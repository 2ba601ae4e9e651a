"""Sections from templates: numbered tables and figures, each paragraph on one line."""

import csv

import pandas as pd
from hostile import HOSTILE, SEEN
from jinja2 import Template
from matplotlib.figure import Figure

from pipeline.figures import tables
from pipeline.figures.labels import number, share
from pipeline.figures.tables import Column, Picture, Section, Table, Writer, file_name, write_csv

SHARES = pd.DataFrame(
    {
        "name": ["a | b", "c"],
        "mean": [0.5, 1.0],
        "spread": [0.25, float("nan")],
        "low": [0.25, float("nan")],
        "high": [0.75, float("nan")],
    }
)


def examples(*titles):
    pictures = [(title, Picture(f"figure-{title}", Figure())) for title in titles]
    return Section("pipeline/experiments/examples.md.jinja", {"pictures": pictures})


def test_figures_are_numbered_through_all_sections_with_their_captions_on_one_line():
    writer = Writer()
    first, second = writer.write(examples("one", "two")), writer.write(examples("three"))
    assert first.startswith(
        "## Example transfers\n\n![Figure 1](figures/figure-one.svg)\n*Figure 1. one ("
    )
    assert "\n\n![Figure 2](figures/figure-two.svg)\n*Figure 2. two (compare" in first
    assert "*Figure 3. three (compare" in second
    assert all(line.endswith("orbits.*") for line in first.splitlines() if line.startswith("*"))
    assert [p.name for p in writer.pictures] == ["figure-one", "figure-two", "figure-three"]


def test_each_item_of_a_list_has_a_line(monkeypatch):
    text = Template("Two\n- 1 =\nhalves:\n\n- one\n  half\n- the other\n\nEnd.")
    monkeypatch.setattr(tables, "template", lambda _: text)
    written = Writer().write(Section("any", {}))
    assert written == "Two - 1 = halves:\n\n- one half\n- the other\n\nEnd."


def test_a_section_without_what_it_shows_says_how_to_get_it():
    writer = Writer()
    assert "`prolearn evaluate` keeps some to draw." in writer.write(examples())
    assert writer.pictures == []


def test_a_table_says_what_its_signs_mean_and_only_those_that_it_has():
    plain = Table("t", SHARES, [Column("Name", "name"), Column("Mean", "mean", number)])
    assert plain.notation == ""
    spread = Column("Mean", "mean", number, "spread")
    assert Table("t", SHARES, [spread]).notation.startswith(
        "Networks trained with several seeds show"
    )
    once = SHARES.assign(spread=float("nan"))
    assert Table("t", once, [spread]).notation == "", "each was trained once"
    interval = Column("Share", "mean", share, interval=("low", "high"))
    assert Table("t", SHARES, [interval]).notation.startswith(
        "Brackets are 95 % intervals: Wilson's"
    )


def test_columns_of_one_heading_stand_beside_each_other():
    spread = Column("paper", "mean", number, "spread")
    interval = Column("paper", "mean", share, interval=("low", "high"))
    lines = Table("t", SHARES, [Column("Name", "name"), spread, interval]).markdown.splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]
    assert rows[0] == ["Name", "paper", "paper"]
    assert rows[2] == ["a \\| b", "0.500 ± 0.250", "50 % [25.0, 75.0]"]
    assert rows[3] == ["c", "1.00", "100 %"]


def test_a_csv_file_has_a_line_for_each_row_whatever_its_texts_are(tmp_path):
    frame = pd.DataFrame({HOSTILE: [HOSTILE, "a,\rb"], "n": [1, None], "x": [True, pd.NA]})
    write_csv(frame.astype({"n": "Int64"}), tmp_path / "t.csv")
    with (tmp_path / "t.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    assert rows == [[SEEN, "n", "x"], [SEEN, "1", "True"], ["a,\\rb", "", ""]]


def test_names_of_files_are_plain_and_no_two_are_one():
    assert file_name("experiment2-n10") == "experiment2-n10"
    names = ["../../etc/a", "..-..-etc-a", "..-..-etc:a", "a" * 5000, "a" * 4999, "é", "", HOSTILE]
    found = [file_name(name) for name in names]
    assert len(set(found)) == len(names)
    assert all(len(name) < 100 and not {*name} & {*"/\\:\x1b\n"} for name in found)
