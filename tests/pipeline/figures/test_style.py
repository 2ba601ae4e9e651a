"""One styles for all figures."""

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier, BrokenBarrierError

import matplotlib
import numpy as np
import pytest
from hostile import NAME, SEEN_NAME
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pipeline.figures.labels import (
    BASELINES,
    EXPERTS,
    FEED_FORWARD,
    RECURRENT,
    REFINERS,
    label_name,
    name_of,
)
from pipeline.figures.style import KNOWN, fit_scale, in_style, planner_styles, save


def test_each_planner_has_a_colour_and_a_marker_of_its_own():
    styles = planner_styles(["ff1", "my net", "another", "third"])
    assert set(styles) == {
        *EXPERTS,
        *BASELINES,
        *FEED_FORWARD,
        *RECURRENT,
        *REFINERS,
        "my net",
        "another",
        "third",
    }
    assert len({s.colour for s in styles.values()}) == len(styles)
    assert len({s.marker for s in styles.values()}) == len(styles)


def test_families_are_told_apart_by_their_lines():
    assert {KNOWN[p].line for p in FEED_FORWARD} == {"-"}
    assert {KNOWN[p].line for p in RECURRENT} == {"--"}
    assert {KNOWN[p].line for p in BASELINES} == {":"}


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


@pytest.mark.filterwarnings("error")
def test_names_are_drawn_as_they_are(tmp_path):
    @in_style
    def drawn():
        figure = Figure(layout="constrained")
        ax = figure.subplots()
        ax.set_title(f"{NAME} title")
        ax.set_yticks([0, 1], [name_of(NAME), f"{label_name(NAME)} seed"])
        figure.legend(handles=[Line2D([], [], label=f"_{NAME} legend")])
        return figure

    save(drawn(), tmp_path / "f", [".svg"])
    text = (tmp_path / "f.svg").read_text(encoding="utf-8")
    for name in (f"{SEEN_NAME} title", SEEN_NAME, f"{SEEN_NAME} seed", f"_{SEEN_NAME} legend"):
        assert f"<!-- {name} -->" in text


def test_figures_drawn_in_threads_leave_the_callers_settings():
    @in_style
    def drawn(both):
        with pytest.raises(BrokenBarrierError):  # no two draw at the same time
            both.wait(0.2)
        return matplotlib.rcParams["axes.grid"]

    before = dict(matplotlib.rcParams)
    with ThreadPoolExecutor(2) as threads:
        assert all(threads.map(drawn, [Barrier(2)] * 2))
    assert dict(matplotlib.rcParams) == before


def test_powers_of_ten_are_drawn_without_a_formula(tmp_path):
    @in_style
    def drawn():
        figure = Figure()
        ax = figure.subplots()
        fit_scale(ax, "x", [1e4, 1e6])  # so few that every matplotlib labels all of them
        fit_scale(ax, "y", [1e-6, 1e-4])
        return figure

    save(drawn(), tmp_path / "f", [".svg"])
    text = (tmp_path / "f.svg").read_text(encoding="utf-8")
    assert "<!-- 10⁻⁶ -->" in text and "<!-- 10⁴ -->" in text


def drawn_numbers(values, log=False):
    """The numbers that stand within the limits of an axis, as text and as values."""
    figure = Figure()
    ax = figure.subplots()
    ax.plot(values)
    fit_scale(ax, "y", values, log=log)
    figure.draw_without_rendering()
    low, high = ax.get_ylim()
    axis = ax.yaxis
    ticks = zip(axis.get_majorticklabels(), axis.get_majorticklocs(), strict=True)
    return [(text.get_text(), at) for text, at in ticks if low <= at <= high]


def test_numbers_on_a_logarithmic_axis_are_the_values_at_which_they_stand():
    powers = "⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789"
    for values in ([1.5e-4, 6e-3], [3e4, 1.2e6], [2e-9, 3e-8]):
        found = drawn_numbers(values, log=True)
        assert len(found) >= 2
        for text, at in found:
            factor, _, power = text.replace("·10", "·").rpartition("·")
            if text.startswith("10"):
                factor, power = "1", text[2:]
            if set(text) & set(powers[0]):
                text = f"{factor}e{power.translate(str.maketrans(*powers))}"
            assert float(text) == pytest.approx(at)
    assert "5·10⁻⁴" in [text for text, _ in drawn_numbers([1.5e-4, 6e-3], log=True)]


@pytest.mark.parametrize("low", [0.6, 0.8, 1.1, 2.1])
@pytest.mark.parametrize("times", [1.1, 1.5, 3.0, 3.3, 6.0])
def test_a_narrow_range_has_several_numbers(low, times):
    assert len(drawn_numbers([low, low * times], log=True)) >= 2


def test_an_axis_of_zeros_has_no_negative_number():
    assert min(at for _, at in drawn_numbers([0.0, 0.0, 0.0])) == 0
