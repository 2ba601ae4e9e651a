import pandas as pd
import pytest

from pipeline.exhibits.numbers import count, error, number, ratio, share
from pipeline.experiments import paper
from pipeline.experiments.averages import summarize
from pipeline.experiments.experiment1.table import objectives_table
from pipeline.experiments.experiment2.table import scaling_tables
from pipeline.experiments.experiment3.table import warmstart_tables
from pipeline.experiments.trainings.table import training_table

ALL_OF_3 = "100 % [43.9, 100.0]"
"""With Wilson's interval, which ends at 3 / (3 + 1.96²)."""


def cells(table):
    """The printed table as {row's left cells: other cells}."""
    lines = [
        [c.strip() for c in line.strip("|").split("|")] for line in table.markdown().splitlines()
    ]
    return lines[0], lines[2:]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (0.04996, "0.0500"),
        (1.906, "1.91"),
        (99.96, "100"),
        (12345.6, "12,346"),
        (2.27e-13, "2.27e-13"),
        (0.00123, "0.00123"),
        (0.00099999, "0.00100"),
        (-0.5, "-0.500"),
        (float("nan"), "–"),
        (float("inf"), "∞"),
    ],
)
def test_numbers_have_three_significant_digits(value, text):
    assert number(value) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1.0, "100 %"),
        (0.0, "0 %"),
        (0.9999, "> 99.9 %"),
        (0.0001, "< 0.1 %"),
        (0.25, "25 %"),
        (0.996, "99.6 %"),
        (float("nan"), "–"),
    ],
)
def test_shares_read_all_or_nothing_only_where_they_are(value, text):
    assert share(value) == text


def test_ratios_counts_and_errors_suit_their_kind():
    assert (ratio(1.0111), ratio(26.54), count(1234.0)) == ("1.011", "26.5", "1,234")
    assert (error(3e-13), error(0.02), error(float("nan"))) == ("< 1e-6", "0.0200", "–")


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


def test_predicted_rows_show_their_errors_and_no_safety(trials):
    _, body = cells(objectives_table(summarize(trials), 10))
    predicted = next(r for r in body if r[:3] == ["FF1", "paper", "predicted"])
    assert predicted[7:9] == ["–", "–"]
    assert predicted[-2:] == ["40.0", "8.00"]


def test_the_papers_numbers_stand_only_beside_its_own_swarm_size(trials):
    _, body = cells(objectives_table(summarize(trials), 30))
    assert all(r[4] == r[6] == r[10] == "–" for r in body)


def test_training_times_stand_beside_the_papers(results):
    header, body = cells(training_table(results.training))
    assert [r[0] for r in body] == ["FF1", "LSTM1", "my net"]
    at = header.index("Time (s)")
    assert [r[at : at + 2] for r in body] == [["12.5", "25.1"], ["12.5", "207"], ["12.5", "–"]]


def test_scaling_tables_have_a_column_for_each_size_and_no_predicted_safety(trials):
    collisions, safe, fuel = scaling_tables(summarize(trials))
    header, body = cells(collisions)
    assert header[3:] == ["n = 10", "n = 30"]
    assert [r[:3] for r in body][:3] == [
        ["Expert", "", "plan"],
        ["Minimum energy", "", "plan"],
        ["FF1", "paper", "predicted"],
    ]
    assert "predicted" not in {r[2] for r in cells(safe)[1]}
    assert ["my net", "tuned", "flown", "1.060", "1.060"] in cells(fuel)[1]


def test_many_sizes_are_all_in_the_file_and_few_on_the_page(trials_at):
    table = scaling_tables(summarize(trials_at(*range(2, 31))))[0]
    assert cells(table)[0][3:] == ["n = 2", "n = 5", "n = 10", "n = 20", "n = 30"]
    assert {str(n) for n in range(2, 31)} <= set(table.frame.columns)


def test_warm_start_tables_print_the_ratio_to_no_seed(warmstarts):
    (table,) = warmstart_tables(warmstarts, "expert")
    _, body = cells(table)
    assert ["first safe", "FF1 tuned", "2.00", "66.7 %", "0.100", "0.250", "15.0", ALL_OF_3] in body


def test_the_plain_scps_table_says_what_is_clear_at_the_nodes_and_what_at_all_times(both):
    (table,) = warmstart_tables(both, "plain")
    header, body = cells(table)
    assert header[-2:] == ["Clear at the nodes", "Safe at all times"]
    row = ["No seed", "10.0", "0 %", "5.00", "3.61", "4.00", "1.000", "10.0"]
    assert [
        *row,
        ALL_OF_3,
        "0 % [0.0, 56.1]",
    ] in body  # of 2, 4 and 9 s: mean 5, standard deviation √13, median 4
    assert [r[0] for r in body] == ["No seed", "Own LP", "FF1 tuned"]
    assert next(r for r in body if r[0] == "FF1 tuned")[6] == "0.250"  # 1 s of 4 s


def test_the_paper_quotes_every_architecture_in_each_of_its_tables():
    names = {"ff1", "ff2", "ffcol", "lstm1", "lstm2", "lstmcol"}
    assert set(paper.NEURONS) == set(paper.TRAIN_SECONDS) == names
    assert set(paper.OBJECTIVES) == names | {"expert"}


def test_averages_over_training_seeds_show_their_spread(trials, results):
    further = trials[trials["planner"] == "ff1"].assign(training_seed=1)
    further["fuel"] += 1.0
    summary = summarize(pd.concat([trials, further]))
    table = objectives_table(summary, 10)
    ff1 = next(r for r in cells(table)[1] if r[:3] == ["FF1", "paper", "flown"])
    assert ff1[3] == "1.50 ± 0"
    assert ff1[9] == "3.50 ± 0.707"
    assert "± the standard deviation" in table.caption
    fuel = scaling_tables(summary)[2]
    assert ["FF1", "paper", "flown", "3.500 ± 0.707", "3.500 ± 0.707"] in cells(fuel)[1]
    training = pd.concat([results.training, results.training.assign(training_seed=1, version="2")])
    header, body = cells(training_table(training))
    assert [r[header.index("Versions")] for r in body] == ["1, 2"] * 3
    assert [r[header.index("Time (s)")] for r in body] == ["12.5 ± 0"] * 3
