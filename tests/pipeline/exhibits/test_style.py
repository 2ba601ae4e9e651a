"""One look for all figures."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from pipeline.exhibits.axes import fit_scale
from pipeline.exhibits.planners import BARGAINING, BASELINES, EXPERTS, FEED_FORWARD, RECURRENT
from pipeline.exhibits.style import KNOWN, styles


def test_each_planner_has_a_colour_and_a_marker_of_its_own():
    look = styles(["ff1", "my net", "another", "third"])
    assert set(look) == {
        *EXPERTS,
        *BASELINES,
        *FEED_FORWARD,
        *RECURRENT,
        *BARGAINING,
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
