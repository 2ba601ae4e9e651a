import matplotlib
import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from pipeline.exhibits.axes import fit_scale
from pipeline.exhibits.planners import BASELINES, EXPERTS, FEED_FORWARD, RECURRENT
from pipeline.exhibits.style import KNOWN, styles
from pipeline.experiments.averages import summarize
from pipeline.experiments.examples.figure import _orbits, figure_transfer, within
from pipeline.experiments.examples.run import Example
from pipeline.experiments.experiment1.figure import objectives_figure
from pipeline.experiments.experiment2.figure import COLLISIONS, FUEL, scaling_figure
from pipeline.experiments.experiment3.figure import optimizers_figure, warmstart_figure


def lines_of(ax, colour):
    return [line for line in ax.get_lines() if line.get_color() == colour]


def test_each_planner_has_a_colour_and_a_marker_of_its_own():
    look = styles(["ff1", "my net", "another", "third"])
    assert set(look) == {
        *EXPERTS,
        *BASELINES,
        *FEED_FORWARD,
        *RECURRENT,
        "my net",
        "another",
        "third",
    }
    assert len({s.colour for s in look.values()}) == len(look)
    assert len({s.marker for s in look.values()}) == len(look)


def test_families_are_told_apart_by_their_lines():
    assert {KNOWN[p].line for p in FEED_FORWARD} == {"-"}
    assert {KNOWN[p].line for p in RECURRENT} == {"--"}
    assert {KNOWN[p].line for p in BASELINES} == {":"}


def test_scaling_shows_the_averages_and_the_papers_points(trials):
    summary = summarize(trials)
    look = styles(summary["planner"])
    figure = scaling_figure(summary, COLLISIONS, look)
    flown = next(ax for ax in figure.axes if ax.get_title(loc="left") == "paper recipe, flown")
    curve = next(x for x in lines_of(flown, look["ff1"].colour) if len(x.get_xdata()) == 2)
    np.testing.assert_allclose(curve.get_xydata(), [[10, 1.5], [30, 1.5]])
    hollow = [x for x in flown.get_lines() if x.get_markerfacecolor() == "white"]
    points = sorted(float(x.get_ydata()[0]) for x in hollow)
    assert points == [0.113, 1.06, 1.326, 1.594, 4.64, 14.74]


def test_a_planner_unknown_to_the_paper_is_drawn_and_named(trials):
    summary = summarize(trials)
    figure = scaling_figure(summary, FUEL, styles(summary["planner"]))
    names = [t.get_text() for t in figure.legends[0].get_texts()]
    assert "my net" in names
    assert "hollow: in the paper" in names


def test_two_recipes_of_a_network_whose_output_is_a_plan_are_both_drawn(rows):
    table = pd.DataFrame(
        [
            row
            for n in (10, 30)
            for recipe, fuel in (("paper", 2.0), ("tuned", 3.0))
            for row in rows("my net", recipe, "plan", n, [0], [fuel], [True])
        ]
    )
    figure = scaling_figure(summarize(table), FUEL, styles(["my net"]))
    drawn = [line.get_ydata().tolist() for ax in figure.axes for line in ax.get_lines()]
    assert [2.0, 2.0] in drawn
    assert [3.0, 3.0] in drawn


def test_objectives_are_drawn_where_the_table_has_them(trials):
    summary = summarize(trials)
    look = styles(summary["planner"])
    left, right = objectives_figure(summary, 10, look).axes
    rows = [t.get_text() for t in left.get_yticklabels()]
    assert rows == ["Expert", "Minimum energy", "FF1", "LSTM1", "my net"]
    dots = [x for x in right.get_lines() if x.get_markeredgecolor() == look["ff1"].colour]
    assert sorted(float(np.ravel(x.get_xdata())[0]) for x in dots) == [3.0, 10.0]
    ticks = [x for x in right.get_lines() if x.get_marker() == "|"]
    assert sorted(float(np.ravel(x.get_xdata())[0]) for x in ticks) == [0.0494, 0.95, 1.906]


def test_a_box_has_the_quartiles_of_its_seed(warmstarts):
    look = styles(["ff1"])
    figure = warmstart_figure(warmstarts, 10, look)
    first_safe = next(a for a in figure.axes if "first safe" in a.get_title(loc="left"))
    box = first_safe.patches[0].get_path().vertices[:, 0]  # none: 0.2, 0.4, 0.9 s
    assert (box.min(), box.max()) == pytest.approx((0.3, 0.65))


def test_figure_8_has_both_optimizers_side_by_side(both):
    unseeded = both[both["rule"] == "first safe"].assign(rule="converged")
    both = pd.concat([both, unseeded[unseeded["seed"] == "none"]])
    plain, expert = optimizers_figure(both, 10, styles(["ff1"])).axes
    assert (plain.get_title(loc="left"), expert.get_title(loc="left")) == (
        "Plain SCP, n = 10",
        "Our expert, n = 10",
    )
    assert [t.get_text() for t in plain.get_yticklabels()] == ["No seed", "Own LP", "FF1 tuned"]
    assert plain.get_xlim() == expert.get_xlim()
    assert [t.get_text() for t in expert.texts] == ["its own start: as without a seed"]
    box = plain.patches[0].get_path().vertices[:, 0]  # none: 2, 4, 9 s
    assert (box.min(), box.max()) == pytest.approx((3.0, 6.5))


def test_the_experts_own_figure_has_none_of_the_plain_scps_times(both):
    figure = warmstart_figure(both, 10, styles(["ff1"]))
    rows = [t.get_text() for t in figure.axes[0].get_yticklabels()]
    assert rows == ["No seed", "FF1 tuned"]
    assert figure.axes[0].get_xlim()[1] < 2.0


@pytest.mark.parametrize(
    ("values", "scale"),
    [
        ([1.0, 2.0], "linear"),
        ([0.0, 0.0], "linear"),
        ([0.0, 0.01, 10.0], "symlog"),
        ([0.01, 10.0], "log"),
        ([float("nan"), 0.01, 10.0], "log"),
    ],
)
def test_scales_are_logarithmic_where_values_span_decades(values, scale):
    ax = Figure().subplots()
    fit_scale(ax, "y", values)
    assert ax.get_yscale() == scale
    low, high = ax.get_ylim()
    assert low <= np.nanmin(values)
    assert scale == "linear" or high >= np.nanmax(values)


def test_conflicts_are_marked_where_two_craft_are_within_the_radius(example):
    # Separation is 2 √(x² + 5²): within 15 m where |x| ≤ √31.25 = 5.59, at x = -5, 0 and 5.
    close = within(example.tracks["expert"], 15.0)
    x = example.tracks["expert"][0, :, 0]
    assert sorted(x[close[0]]) == pytest.approx([-5, 0, 5])
    assert (close[0] == close[1]).all()


def test_a_lone_craft_is_never_in_conflict():
    assert not within(np.zeros((1, 4, 3)), 15.0).any()


def test_passive_orbits_are_two_by_one_ellipses(example):
    orbit = _orbits(example.initial)[0]  # x = 100 cos θ, y = -200 sin θ
    np.testing.assert_allclose((orbit[:, 0] / 100) ** 2 + (orbit[:, 1] / 200) ** 2, 1, rtol=1e-9)
    np.testing.assert_allclose(orbit[0], orbit[-1], atol=1e-6)


def test_states_that_drift_show_as_points():
    assert _orbits(np.array([[100.0, 0, 0, 0, -0.2, 0], [50.0, 0, 0, 0, 0.4, 0]])).shape == (
        2,
        1,
        3,
    )


@pytest.mark.parametrize("count", [1, 4])
def test_a_transfer_has_a_panel_for_each_planner_at_one_equal_scale(example, count):
    tracks = {f"planner {k}": example.tracks["expert"] * (1 + k) for k in range(count)}
    shown = Example(example.title, example.initial, example.goal, tracks, 15.0)
    figure = figure_transfer(shown)
    assert len(figure.axes) == count
    for ax in figure.axes:
        ranges = _ranges(ax)
        np.testing.assert_allclose(ranges, _ranges(figure.axes[0]))
        shape = np.asarray(ax._box_aspect)
        np.testing.assert_allclose(shape / shape[0], ranges / ranges[0])


def _ranges(ax):
    return np.array([np.ptp(ax.get_xlim()), np.ptp(ax.get_ylim()), np.ptp(ax.get_zlim())])


def test_drawing_leaves_the_callers_settings_alone(example):
    before = dict(matplotlib.rcParams)
    figure_transfer(example)
    assert dict(matplotlib.rcParams) == before


def test_panels_are_named_after_planner_and_recipe(example):
    tracks = dict.fromkeys(("expert", "ff1 tuned", "own LP"), example.tracks["expert"])
    figure = figure_transfer(Example("", example.initial, example.goal, tracks, 15.0))
    names = [t.get_text() for t in figure.texts]
    assert {"Expert", "FF1 tuned", "Own LP"} <= set(names)
