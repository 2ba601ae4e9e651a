"""Experiment 1: figure, table and verdicts."""

import numpy as np
import pandas as pd
from planted import cells

from pipeline.experiments.averages import summarize
from pipeline.experiments.experiment1 import (
    objectives_figure,
    objectives_table,
    paper_findings,
    section,
)
from pipeline.figures.style import planner_styles
from pipeline.figures.tables import Writer


def test_objectives_are_drawn_where_the_table_has_them(trials):
    summary = summarize(trials)
    styles = planner_styles(summary["planner"])
    left, right = objectives_figure(summary, 10, styles).axes
    rows = [t.get_text() for t in left.get_yticklabels()]
    assert rows == ["Expert", "Minimum energy", "FF1", "LSTM1", "my net"]
    dots = [x for x in right.get_lines() if x.get_markeredgecolor() == styles["ff1"].colour]
    assert sorted(float(np.ravel(x.get_xdata())[0]) for x in dots) == [3.0, 10.0]
    ticks = [x for x in right.get_lines() if x.get_marker() == "|"]
    assert sorted(float(np.ravel(x.get_xdata())[0]) for x in ticks) == [0.0494, 0.95, 1.906]


def test_the_objectives_stand_beside_the_papers(trials):
    header, body = cells(objectives_table(summarize(trials), 10))
    assert header[3:8] == ["Collisions, av.", "paper", "Collisions, max.", "paper", header[7]]
    ff1 = next(r for r in body if r[:3] == ["FF1", "paper", "flown"])
    assert ff1[3:7] == ["1.50", "1.33", "3", "13"]
    assert ff1[8:12] == ["50 % [9.5, 90.5]", "3.00", "1.91", "3.000"]  # Wilson of 1 in 2
    expert = next(r for r in body if r[0] == "Expert")
    assert expert[3:7] == ["0", "0.113", "0", "2"]
    unknown = next(r for r in body if r[0] == "my net")
    assert (unknown[4], unknown[6], unknown[10]) == ("–", "–", "–")


def test_it_is_said_in_how_many_trials_the_expert_has_no_safe_plan(trials):
    def text(given):
        return Writer().write(section(summarize(given), 10, planner_styles(given["planner"])))

    assert "has no safe plan" not in text(trials)
    first = (trials["planner"] == "expert") & (trials["trial"] == 0)
    infeasible = trials.assign(safe=trials["safe"].mask(first, False))
    assert "In 1 of the trials the expert has no safe plan" in text(infeasible)
    assert "All averages are of all trials, these included: its fuel" in text(infeasible)


def test_predicted_rows_show_their_errors_and_no_safety(trials):
    _, body = cells(objectives_table(summarize(trials), 10))
    predicted = next(r for r in body if r[:3] == ["FF1", "paper", "predicted"])
    assert predicted[7:9] == ["–", "–"]
    assert predicted[-2:] == ["40.0", "8.00"]


def test_the_papers_numbers_stand_only_beside_its_own_swarm_size(trials):
    _, body = cells(objectives_table(summarize(trials), 30))
    assert all(r[4] == r[6] == r[10] == "–" for r in body)


def table_2(rows, *networks):
    made = [
        row
        for planner, recipe, reading, collisions, fuel in networks
        for row in rows(
            planner, recipe, reading, 10, collisions, [fuel] * len(collisions), [True] * 2
        )
    ]
    return summarize(pd.DataFrame(made))


def test_the_papers_recipe_is_near_where_it_is_within_a_factor_of_two(rows):
    """The paper has FF1 1.326 / 1.906 and LSTM2 1.428 / 0.76."""
    summary = table_2(
        rows,
        ("ff1", "paper", "predicted", [1, 2], 1.0),  # 1.13 and 0.525 times
        ("lstm2", "paper", "predicted", [3, 3], 0.076),  # 2.10 and 0.1 times
    )
    (answer,) = paper_findings(summary)
    assert answer.verdict == "In part"
    assert "collisions 1.13 to 2.10 and fuel 0.100 to 0.525 times the paper's" in answer.numbers
    assert "within a factor of 2: collisions FF1, fuel FF1" in answer.numbers


def test_the_tuned_recipe_is_held_to_half_the_collisions_and_a_tenth_of_the_fuel(rows):
    summary = table_2(
        rows,
        ("ff1", "tuned", "flown", [0, 1], 0.19),  # 0.377 and 0.0997 times
        ("lstm2", "tuned", "flown", [1, 1], 0.08),  # 0.700 and 0.105 times
    )
    (answer,) = paper_findings(summary)
    assert (answer.verdict, answer.numbers[-24:]) == ("In part", "1 and 1 of 2 networks do")
