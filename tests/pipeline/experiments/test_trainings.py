"""The table of trainings."""

import pandas as pd
import pytest
from planted import cells

from pipeline.experiments import paper
from pipeline.experiments.averages import summarize
from pipeline.experiments.experiment1 import objectives_table
from pipeline.experiments.experiment2 import sizes_tables
from pipeline.experiments.trainings import curves_figure, findings, training_table
from pipeline.figures.style import planner_styles


def test_training_times_stand_beside_the_papers(results):
    header, body = cells(training_table(results.training))
    assert [r[0] for r in body] == ["FF1", "LSTM1", "my net"]
    at = header.index("Time (s)")
    assert [r[at : at + 2] for r in body] == [["12.5", "25.1"], ["12.5", "207"], ["12.5", "–"]]


def test_the_paper_quotes_every_architecture_in_each_of_its_tables():
    names = {"ff1", "ff2", "ffcol", "lstm1", "lstm2", "lstmcol"}
    assert set(paper.TRAININGS.index) == names
    assert set(paper.OBJECTIVES.index) == names | {"expert"}
    assert not paper.TRAININGS.isna().any(axis=None)
    assert not paper.OBJECTIVES.isna().any(axis=None)


def test_averages_over_training_seeds_show_their_spread(trials, results):
    further = trials[trials["planner"] == "ff1"].assign(training_seed=1)
    further["fuel"] += 1.0
    summary = summarize(pd.concat([trials, further]))
    table = objectives_table(summary, 10)
    ff1 = next(r for r in cells(table)[1] if r[:3] == ["FF1", "paper", "flown"])
    assert ff1[3] == "1.50 ± 0"
    assert ff1[9] == "3.50 ± 0.71"
    assert "± the standard deviation" in table.notation
    fuel = sizes_tables(summary)["fuel"]
    assert ["FF1", "paper", "flown", "3.500 ± 0.707", "3.500 ± 0.707"] in cells(fuel)[1]
    training = pd.concat([results.training, results.training.assign(training_seed=1, version="2")])
    header, body = cells(training_table(training))
    assert [r[header.index("Versions")] for r in body] == ["1, 2"] * 3
    assert [r[header.index("Time (s)")] for r in body] == ["12.5 ± 0"] * 3


@pytest.mark.parametrize(
    ("seconds", "verdict"),
    [
        (((10, 12), (20, 24)), "Confirmed"),
        (((30, 32), (20, 24)), "Contradicted"),
        (((10, 20), (18, 20)), "Open: within the spread"),  # 15 ± 7.1 against 19 ± 1.4
        (((10,), (20, 24)), "Open: only one training of some; points to yes"),
    ],
)
def test_feed_forward_networks_train_quicker_where_they_do_beyond_the_spread(
    results, seconds, verdict
):
    planted = results.training.set_index("arch")
    table = pd.DataFrame(
        [
            {**planted.loc[arch], "arch": arch, "training_seed": seed, "seconds": taken}
            for arch, times in zip(("ff1", "lstm1"), seconds, strict=True)
            for seed, taken in enumerate(times)
        ]
    )
    (answer,) = findings(table)
    assert answer.verdict == verdict
    assert answer.numbers.endswith("(paper: 25.1 to 264 against 207 to 1,291)")
    for name, other in (("threads", "8"), ("n", 3), ("train_instances", 100)):
        column = table[name].mask(table["arch"] == "ff1", other)
        assert findings(table.assign(**{name: column})) == []


@pytest.mark.parametrize(("epochs", "marker"), [(1, "."), (2, "")])
def test_losses_of_one_epoch_are_points_since_no_line_is_seen(epochs, marker):
    losses = {"epoch": range(1, epochs + 1), "train_loss": 0.2, "valid_loss": 0.1}
    curves = pd.DataFrame(losses).assign(arch="ff1", recipe="tuned", training_seed=0)
    (panel,) = curves_figure(curves, planner_styles(["ff1"])).axes
    assert [line.get_marker() for line in panel.lines] == [marker, marker]
