"""Rows beside the paper's Table 2: FF1 1.326 / 1.906, LSTM2 1.428 / 0.76."""

import pandas as pd

from pipeline.report.answers.paper import paper_comparison
from pipeline.report.summary.trials import summarize


def table(rows, planner, recipe, reading, collisions, fuel):
    safe = [True] * len(collisions)
    return rows(planner, recipe, reading, 10, collisions, [fuel] * len(collisions), safe)


def test_the_papers_recipe_is_near_where_it_is_within_a_factor_of_two(rows):
    trials = [
        *table(rows, "ff1", "paper", "predicted", [1, 2], 1.0),  # 1.13 and 0.525 times
        *table(rows, "lstm2", "paper", "predicted", [3, 3], 0.076),  # 2.10 and 0.1 times
    ]
    text = paper_comparison(summarize(pd.DataFrame(trials)))
    assert "collisions are within a factor of 2 of the paper's for FF1 and fuel is for FF1" in text
    assert "collisions are 1.13 to 2.10 and fuel 0.100 to 0.525 times the paper's" in text
    assert "tuned" not in text


def test_the_tuned_recipe_is_held_to_half_the_collisions_and_a_tenth_of_the_fuel(rows):
    trials = [
        *table(rows, "ff1", "tuned", "flown", [0, 1], 0.19),  # 0.377 and 0.0997 times
        *table(rows, "lstm2", "tuned", "flown", [1, 1], 0.08),  # 0.700 and 0.105 times
    ]
    text = paper_comparison(summarize(pd.DataFrame(trials)))
    assert "1 of 2 networks have at most half the paper's collisions (most: LSTM2, 0.700" in text
    assert "1 of 2 need at most a tenth of its fuel (most: LSTM2, 0.105" in text


def test_without_networks_of_the_paper_nothing_is_said(trials):
    others = trials[~trials["planner"].isin(["ff1", "lstm1"])]
    assert paper_comparison(summarize(others)) == ""
