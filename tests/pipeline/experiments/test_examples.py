"""Example transfers and their figure."""

import matplotlib
import numpy as np
import pytest

from pipeline.errors import InputError
from pipeline.experiments.example_transfer import read_example, write_example
from pipeline.figures.transfer import Example, _orbits, transfer_figure, within


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
    figure = transfer_figure(shown)
    assert len(figure.axes) == count
    for ax in figure.axes:
        ranges = _ranges(ax)
        np.testing.assert_allclose(ranges, _ranges(figure.axes[0]))
        shape = np.asarray(ax._box_aspect)
        np.testing.assert_allclose(shape / shape[0], ranges / ranges[0])


def test_an_example_comes_back_as_it_was_written(example, tmp_path):
    write_example(example, tmp_path / "example.npz")
    again = read_example(tmp_path / "example.npz")
    assert (again.title, again.collision_radius) == (example.title, example.collision_radius)
    for one, other in ((again.initial, example.initial), (again.goal, example.goal)):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(again.tracks["expert"], example.tracks["expert"])


class Payload:
    def __init__(self, mark):
        self.mark = mark

    def __reduce__(self):
        return type(self.mark).touch, (self.mark,)


FORGED = {
    "a pickle": lambda mark: {"initial": np.array([Payload(mark)], object)},
    "other shapes": lambda _: {"goal": np.zeros((3, 6))},
    "other dimensions": lambda _: {"track:expert": np.zeros((2, 3))},
    "no numbers": lambda _: {"collision_radius": np.array("near")},
    "a radius for each": lambda _: {"collision_radius": np.zeros(2)},
    "not finite": lambda _: {"track:expert": np.full((2, 5, 3), np.nan)},
    "too large": lambda _: {"more": np.zeros(MOST_BYTES, bool)},
}


MOST_BYTES = 10**6
"""As the largest file that is read, which takes less time to write than the real one."""


@pytest.mark.parametrize("forged", FORGED.values(), ids=FORGED.keys())
def test_what_is_no_example_is_refused_and_nothing_in_it_runs(
    example, tmp_path, forged, monkeypatch
):
    monkeypatch.setattr("pipeline.experiments.example_transfer.MOST_BYTES", MOST_BYTES)
    path = tmp_path / "example.npz"
    write_example(example, path)
    with np.load(path) as stored:
        whole = dict(stored)
    np.savez_compressed(path, **{**whole, **forged(tmp_path / "ran")})
    with pytest.raises(InputError, match="holds no example transfer"):
        read_example(path)
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize("content", [b"", b"PK", b"\x93NUMPY", b"\x80\x04N."])
def test_what_is_no_file_of_arrays_is_refused(tmp_path, content):
    (tmp_path / "example.npz").write_bytes(content)
    with pytest.raises(InputError, match="holds no example transfer"):
        read_example(tmp_path / "example.npz")


def _ranges(ax):
    return np.array([np.ptp(ax.get_xlim()), np.ptp(ax.get_ylim()), np.ptp(ax.get_zlim())])


def test_drawing_leaves_the_callers_settings_alone(example):
    before = dict(matplotlib.rcParams)
    transfer_figure(example)
    assert dict(matplotlib.rcParams) == before


def test_panels_are_named_after_planner_and_recipe(example):
    tracks = dict.fromkeys(("expert", "ff1 tuned", "decoupled optimum"), example.tracks["expert"])
    figure = transfer_figure(Example("", example.initial, example.goal, tracks, 15.0))
    names = [ax.get_title() for ax in figure.axes]
    assert names == ["Expert", "FF1 tuned", "Decoupled optimum"]
