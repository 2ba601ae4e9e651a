import numpy as np
import pandas as pd
import pytest

from pipeline.errors import InputError
from pipeline.experiments.averages import reference_size, summarize
from pipeline.experiments.experiment3.averages import summarize_warmstarts
from pipeline.report import Results


def row(table, **keys):
    chosen = table
    for key, value in keys.items():
        chosen = chosen[chosen[key] == value]
    assert len(chosen) == 1
    return chosen.iloc[0]


def test_averages_maxima_and_shares_are_those_of_the_trials(trials):
    ff1 = row(summarize(trials), planner="ff1", reading="flown", n=10)
    assert ff1["trials"] == 2
    assert ff1["collisions_mean"] == 1.5
    assert ff1["collisions_max"] == 3
    assert ff1["fuel_mean"] == 3.0
    assert ff1["safe_share"] == 0.5
    assert ff1["seconds_mean"] == 0.25


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


def test_warm_starts_give_solves_shares_medians_and_their_ratio_to_no_seed(warmstarts):
    summary = summarize_warmstarts(warmstarts)
    none = row(summary, rule="first safe", seed="none")
    ff1 = row(summary, rule="first safe", seed="ff1 tuned")
    assert none["solves_mean"] == 2.0
    assert none["one_solve_share"] == pytest.approx(1 / 3)
    assert (none["seconds_median"], none["time_ratio"]) == (0.4, 1.0)
    assert ff1["one_solve_share"] == pytest.approx(2 / 3)
    assert ff1["seconds_median"] == 0.1
    assert ff1["time_ratio"] == pytest.approx(0.25)
    assert ff1["gap_mean"] == pytest.approx(0.15)  # the infinite gap is left out
    assert ff1["safe_share"] == 1.0


def test_warm_starts_without_an_unseeded_run_have_no_ratio(warmstarts):
    converged = row(summarize_warmstarts(warmstarts), rule="converged", seed="ff1 tuned")
    assert np.isnan(converged["time_ratio"])


def test_each_optimizer_is_measured_against_its_own_start(both):
    summary = summarize_warmstarts(both)
    plain = row(summary, optimizer="plain", seed="ff1 tuned")
    assert plain["time_ratio"] == pytest.approx(1.0 / 4.0)
    expert = row(summary, optimizer="expert", rule="first safe", seed="ff1 tuned")
    assert expert["time_ratio"] == pytest.approx(0.1 / 0.4)
    assert np.isnan(row(summary, optimizer="expert", rule="converged")["time_ratio"])
    assert (plain["solved_share"], plain["safe_share"]) == (1.0, 1.0)
    assert row(summary, optimizer="plain", seed="own LP")["safe_share"] == 0.0


def test_results_without_trials_or_columns_are_refused_with_what_to_do(trials):
    with pytest.raises(InputError, match="prolearn evaluate"):
        Results(trials.head(0))
    with pytest.raises(InputError, match="'trials' lacks the columns fuel, seconds"):
        Results(trials.drop(columns=["seconds", "fuel"]))
    with pytest.raises(InputError, match="'curves' lacks"):
        Results(trials, curves=pd.DataFrame({"arch": ["ff1"]}))


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


def test_the_spread_of_warm_starts_is_that_between_trainings(warmstarts):
    further = warmstarts[warmstarts["seed"] == "ff1 tuned"].assign(training_seed=1)
    further = further.assign(seconds=3 * further["seconds"])
    summary = summarize_warmstarts(pd.concat([warmstarts, further]))
    ff1 = row(summary, seed="ff1 tuned", rule="first safe")
    assert ff1["seeds"] == 2
    assert ff1["seconds_median"] == pytest.approx(0.2)  # of 0.1 and 0.3
    assert ff1["time_ratio"] == pytest.approx(0.5)  # to 0.4 without a seed
    assert ff1["ratio_spread"] == pytest.approx(0.5 / 2**0.5)  # of 0.25 and 0.75
    assert ff1["gap_spread"] == 0.0
