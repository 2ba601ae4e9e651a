"""Swarms beyond n = 30, from planted numbers averaged by hand."""

import pandas as pd
import pytest
from planted import cells, flown, row, shares, trained

from pipeline.experiments.averages import prepared, summarize
from pipeline.experiments.experiment2 import family_findings, section, size_findings, sizes_tables
from pipeline.experiments.scaling import (
    findings as scaling_findings,
)
from pipeline.experiments.scaling import (
    larger_swarms,
    scaling_figure,
    scaling_table,
    sections,
    summarize_larger,
)
from pipeline.figures.style import planner_styles
from pipeline.figures.tables import Writer
from pipeline.report import Results, build_report

VALID = trained(("ff1", "paper", 0.2, 1.0), ("lstm1", "paper", 0.8, 1.0))
"""On validation data the LSTM is the safer one."""


@pytest.fixture
def planned(rows):
    """The refiner safe in both of two trials up to n = 60 and in one at 300; two of the paper's."""

    def at(n, refined):
        return [
            *rows("expert", "", "plan", n, [0, 0], [1.0, 1.02], [True, True]),
            *rows("decoupled optimum", "", "plan", n, [3, 5], [1.0, 1.0], [False, False]),
            *rows("straight line", "", "plan", n, [9, 9], [2.0, 2.0], [False, False]),
            *rows("ff1", "paper", "flown", n, [8, 8], [3.0, 3.0], [False, False]),
            *rows("lstm1", "paper", "predicted", n, [9, 9], [9.0, 9.0], [None, None]),
            *rows("lstm1", "paper", "flown", n, [6, 8], [2.0, 4.0], [False, False]),
            *rows("refiner", "tuned", "flown", n, [0, 1], [1.01, 1.03], refined, seconds=0.5),
        ]

    sizes = {10: [True] * 2, 30: [True] * 2, 60: [True] * 2, 300: [True, False]}
    return prepared(pd.DataFrame([x for n, refined in sizes.items() for x in at(n, refined)]))


def test_averages_are_of_the_sizes_beyond_and_of_the_papers_largest(planned):
    summary = summarize_larger(larger_swarms(planned, VALID))
    assert sorted(set(summary["n"])) == [30, 60, 300]
    refiner = row(summary, planner="refiner", n=300)
    assert (refiner["collisions_mean"], refiner["unsafe_share"]) == (0.5, 0.5)
    assert refiner["fuel_ratio"] == pytest.approx(1.02)
    assert refiner["excess"] == pytest.approx(2.0)
    # Wilson of one in two is symmetric about a half: 0.5 ± 1.96 / 2 / √(2 + 1.96²)
    half = 1.959964 / 2 / (2 + 1.959964**2) ** 0.5
    assert refiner[["unsafe_low", "unsafe_high"]].tolist() == pytest.approx(
        [0.5 - half, 0.5 + half]
    )
    assert row(summary, planner="decoupled optimum", n=60)["unsafe_share"] == 1.0


def test_one_network_of_the_papers_is_shown_by_validation_and_every_other(planned):
    shown = larger_swarms(planned, VALID)
    assert set(shown["planner"]) == {"expert", "decoupled optimum", "lstm1", "refiner"}
    assert set(shown["reading"]) == {"plan", "flown"}
    unknown = larger_swarms(planned, trained())
    assert set(unknown["planner"]) == {"expert", "decoupled optimum", "ff1", "lstm1", "refiner"}


def test_the_table_has_a_row_for_each_size_and_planner(planned):
    header, body = cells(scaling_table(summarize_larger(larger_swarms(planned, VALID))))
    assert header[:4] == ["n", "Planner", "Recipe", "Trials"]
    assert [line[:2] for line in body] == [
        [n, name]
        for n in ("30", "60", "300")
        for name in ("Expert", "Decoupled optimum", "LSTM1", "Refiner")
    ]
    assert body[-1] == [
        "300",
        "Refiner",
        "tuned",
        "2",
        "0.500",
        "50 % [9.5, 90.5]",
        "1.020",
        "0.500",
    ]


def test_the_figure_has_the_sizes_side_by_side_and_the_averages_on_them(planned):
    summary = summarize_larger(larger_swarms(planned, VALID))
    styles = planner_styles(summary["planner"])
    figure = scaling_figure(summary, styles)
    excess = figure.axes[2]
    drawn = {line.get_color(): line for line in excess.get_lines()}
    points = drawn[styles["refiner"].colour].get_xydata()
    assert points[:, 0].tolist() == [30, 60, 300]
    assert points[:, 1] == pytest.approx(2.0)
    assert drawn[styles["decoupled optimum"].colour].get_ydata().tolist() == [0, 0, 0]
    assert excess.get_xscale() == "log"


def test_a_verdict_names_the_sizes_at_which_a_network_is_proven_safe_and_cheap(rows):
    def verdict(*safe, fuel=1.0, sizes=(30, 60, 100)):
        table = [
            x
            for n, some in zip(sizes, safe, strict=True)
            for x in flown(rows, "refiner", "tuned", shares(some, 100), fuel, n=n)
        ]
        shown = larger_swarms(prepared(pd.DataFrame(table)), trained())
        (answer,) = scaling_findings(shown, trained())
        assert answer.question == "Does the refiner plan safely and cheaply beyond n = 30?"
        return answer.verdict

    # Wilson's interval of 100 in 100 begins at 96.3 %, that of 99 at 94.6 %; that of 91 ends at
    # 95.2 %, that of 90 at 94.5 %.
    assert verdict(100, 100, 100) == "Yes, wherever tried: n = 30 to n = 100"
    for few in (99, 91):
        said = "At n = 30, n = 60; open, with too few trials: n = 100"
        assert verdict(100, 100, few) == said
    assert verdict(100, 100, 90) == "Only at n = 30, n = 60"
    assert verdict(90, 50, 99) == "Open, with too few trials: n = 100"
    assert verdict(50, 50, 90) == "No"
    five = verdict(100, 100, 100, 50, 100, sizes=(30, 40, 60, 80, 100))
    assert five == "Only at n = 30 to n = 60, n = 100"
    assert verdict(100, 100, 100, fuel=1.2) == "No"


def test_findings_have_the_numbers_of_each_size(planned):
    papers, refiner = scaling_findings(larger_swarms(planned, VALID), VALID)
    assert papers.question == (
        "Does one of the paper's networks plan safely and cheaply beyond n = 30?"
    )
    assert papers.verdict == "No"
    assert papers.numbers.startswith("LSTM1 paper: at n = 30 ")
    assert refiner.verdict == "Open, with too few trials: n = 30, n = 60"
    assert "at n = 300 safe in 50 % [9.5, 90.5] at 1.020 [" in refiner.numbers


def test_without_larger_swarms_there_is_no_section(trials, planned):
    assert sections(prepared(trials), trained(), {}) == []
    assert list(scaling_findings(larger_swarms(prepared(trials), trained()), trained())) == []
    (one,) = sections(planned, VALID, planner_styles(planned["planner"]))
    text = Writer().write(one)
    assert text.startswith("## Beyond 30 spacecraft")
    assert "Collisions, safety, fuel and time at n = 30, 60, 300." in text
    assert "share of trials whose plan breaks a limit of thrust or in which some pair" in text


def test_experiment_2_ends_where_the_paper_does(planned):
    summary = summarize(planned)
    found = section(summary, planner_styles(summary["planner"])).values
    assert found["sizes"] == [10, 30]
    figure = found["pictures"]["collisions"].figure
    drawn = [x for ax in figure.axes for line in ax.get_lines() for x in line.get_xdata()]
    assert max(drawn) < 31
    assert cells(sizes_tables(summary[summary["n"] <= 30])["fuel"])[0][3:] == ["n = 10", "n = 30"]
    training = pd.concat([VALID, trained(("refiner", "tuned", 1.0, 1.0))])
    questions = [a.question for a in size_findings(planned, training, 10)]
    assert questions == [
        "Does one of the paper's networks trained at n = 10 work at other sizes (n = 30)?",
        "Does the refiner trained at n = 10 work at other sizes (n = 30)?",
    ]
    assert "at n = 30" in family_findings(summary)[0].numbers


def test_a_report_of_larger_swarms_alone_is_written(planned, tmp_path):
    large = planned[planned["n"] > 30]
    files = build_report(Results(large), tmp_path)
    text = files.markdown.read_text()
    assert "No n up to 30 was evaluated: `prolearn evaluate --n 2..30`" in text
    assert "beyond" in {p.stem for p in files.figures}
