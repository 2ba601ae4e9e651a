"""Trials averaged over scenarios and over trainings."""

import numpy as np
import pandas as pd
import pytest
from planted import row

from pipeline.experiments.averages import reference_size, summarize, timed_trials


def test_averages_maxima_and_shares_are_those_of_the_trials(trials):
    ff1 = row(summarize(trials), planner="ff1", reading="flown", n=10)
    assert ff1["trials"] == 2
    assert ff1["collisions_mean"] == 1.5
    assert ff1["collisions_max"] == 3
    assert ff1["fuel_mean"] == 3.0
    assert ff1["safe_share"] == 0.5
    assert ff1["seconds_mean"] == 0.25


def test_it_is_said_how_many_trials_were_timed(trials):
    assert timed_trials(summarize(trials)) == "2"
    first = trials["trial"].eq(0) | trials["n"].eq(30)
    some = summarize(trials.assign(seconds=trials["seconds"].where(first)))
    assert row(some, planner="ff1", reading="flown", n=10)["trials"] == 2
    assert timed_trials(some) == "1 to 2"
    assert timed_trials(summarize(trials.assign(seconds=np.nan))) == ""


def test_fuel_ratio_averages_the_trials_ratios_not_the_ratio_of_averages(rows):
    table = pd.DataFrame(rows("ff1", "", "flown", 10, [0, 0], [1.0, 9.0], [True, True]))
    table["fuel_lower_bound"] = [1.0, 3.0]
    assert summarize(table)["fuel_ratio"].iloc[0] == 2.0  # (1 + 3) / 2; of the averages: 2.5


def test_a_bound_of_nothing_leaves_its_trial_out_of_the_fuel_ratio(rows):
    table = pd.DataFrame(rows("ff1", "", "flown", 10, [0, 0], [1.0, 9.0], [True, True]))
    table["fuel_lower_bound"] = [0.0, 3.0]
    assert summarize(table)["fuel_ratio"].iloc[0] == 3.0


def test_predicted_plans_claim_no_safety_whatever_the_table_says(trials):
    trials = trials.assign(safe=True)
    summary = summarize(trials)
    assert summary.loc[summary["reading"] == "predicted", "safe_share"].isna().all()
    assert (summary.loc[summary["reading"] != "predicted", "safe_share"] == 1).all()


def test_unknown_safety_counts_as_unsafe(rows):
    table = pd.DataFrame(rows("ff1", "", "flown", 10, [0, 0], [1, 1], [True, pd.NA]))
    assert summarize(table)["safe_share"].iloc[0] == 0.5


@pytest.mark.parametrize("kind", [object, float, "boolean"])
def test_safety_is_read_from_any_column_type(rows, kind):
    table = pd.DataFrame(rows("ff1", "", "flown", 10, [0, 0], [1, 1], [True, False]))
    assert summarize(table.assign(safe=table["safe"].astype(kind)))["safe_share"].iloc[0] == 0.5


def test_planners_come_in_reading_order_with_unknown_names_last(trials):
    shuffled = trials.sample(frac=1, random_state=1)
    planners = list(summarize(shuffled)["planner"].drop_duplicates())
    assert planners == ["expert", "minimum energy", "ff1", "lstm1", "my net"]


@pytest.mark.parametrize(
    ("sizes", "chosen"), [((2, 10, 30), 10), ((2, 9, 30), 9), ((5, 15), 5), ((30,), 30)]
)
def test_the_reference_size_is_ten_or_the_nearest_smaller_first(trials_at, sizes, chosen):
    assert reference_size(trials_at(*sizes)) == chosen


def seeds_of_ff1(rows):
    """Two trainings of one network: 1 and 3 collisions, fuel 2 and 4, on average."""
    return pd.DataFrame(
        [
            *rows("ff1", "tuned", "flown", 10, [0, 2], [1.0, 3.0], [True, True]),
            *rows("ff1", "tuned", "flown", 10, [2, 4], [3.0, 5.0], [True, False], training_seed=1),
            *rows("expert", "", "plan", 10, [0, 0], [1.0, 1.0], [True, True]),
        ]
    )


def test_trainings_that_differ_in_seed_are_averaged_with_their_spread(rows):
    summary = summarize(seeds_of_ff1(rows))
    ff1 = row(summary, planner="ff1")
    assert (ff1["seeds"], ff1["trials"]) == (2, 2)
    assert (ff1["collisions_mean"], ff1["collisions_max"]) == (2.0, 4)
    assert ff1["collisions_spread"] == pytest.approx(2**0.5)  # of 1 and 3, with n - 1
    assert (ff1["fuel_mean"], ff1["safe_share"]) == (3.0, 0.75)
    assert ff1["safe_spread"] == pytest.approx(0.5**0.5 / 2)  # of 1 and 1/2
    expert = row(summary, planner="expert")
    assert expert["seeds"] == 1
    assert np.isnan(expert["collisions_spread"])
