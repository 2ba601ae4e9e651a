"""Pages and figures of plans for notebooks and files, and plans in formats of other tools."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from io import BytesIO
from pathlib import Path
from reprlib import repr as brief
from typing import TYPE_CHECKING, Literal

import numpy as np

from pipeline.arrays import Array, Float
from pipeline.errors import InputError, check_kind, list_if_iterable, missing_extra_hint
from pipeline.figures.labels import label_name
from pipeline.figures.style import in_style, make_visible, save
from pipeline.figures.transfer import Example, transfer_figure
from pipeline.files import path_of, write_text
from pipeline.orbit.transfer import track
from pipeline.plan.plan import Plan
from pipeline.scenario import Scenario
from pipeline.tradeoff import Point, knee_of, tradeoff_figure
from prolearn.planning import MonteCarlo

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STEPS = 24  # points drawn in each interval
HEIGHT = 1040  # of a page in a notebook, pixels: 700 wide, its bar covers nothing of the motion
DPI = 120  # of a figure in a notebook


@dataclass(frozen=True)
class Page:
    """An HTML page that opens without a network; a notebook shows it in place."""

    html: str

    def write(self, path: str | Path) -> Path:
        """Write it into a file, which appears whole."""
        target = path_of(path)
        write_text(target, self.html)
        return target

    def _repr_html_(self) -> str:
        inside = escape(self.html, quote=True)
        style = f"width: 100%; height: {HEIGHT}px; border: 0"
        return f'<iframe srcdoc="{inside}" style="{style}"></iframe>'

    def __repr__(self) -> str:
        return f"Page({len(self.html) / 1e6:.1f} MB of HTML)"


@dataclass(frozen=True, eq=False)
class Plot:
    """A figure that a notebook shows in place."""

    figure: "Figure"  # matplotlib's

    def write(self, path: str | Path) -> Path:
        """Write it into a file, which appears whole, as its ending says: .png or .svg."""
        target = path_of(path)
        if target.suffix not in (".png", ".svg"):
            raise InputError(f"the figure is to be {target}; expected a name in .png or .svg.")
        save(self.figure, target.with_suffix(""), [target.suffix])
        return target

    @in_style
    def _repr_png_(self) -> bytes:
        content = BytesIO()
        make_visible(self.figure)
        self.figure.savefig(content, format="png", dpi=DPI)
        return content.getvalue()


def show(plan: Plan, name: str = "plan") -> Page:
    """A page of a plan: paths with a slider, separations, controls, recomputed certificate."""
    from pipeline.show import page  # slow to import, and only pages need it

    check_kind("plan", plan, Plan)
    check_kind("name", name, str)
    return Page(page(plan, name)[0])


def plot(what: Plan | Sequence[Plan] | Sequence[Point] | MonteCarlo) -> Plot:
    """A figure of a plan, of several of one scenario, of a trade-off, or of a Monte Carlo.

    Raises:
        InputError: for nothing at all, what is none of these, or plans of several scenarios.
    """
    if isinstance(what, MonteCarlo):
        return Plot(what.figure())
    each = list_if_iterable(what)
    found = each if isinstance(each, list) else [what]
    points = [one for one in found if isinstance(one, Point)]
    plans = [one for one in found if isinstance(one, Plan)]
    if not found or len(found) not in (len(points), len(plans)):
        raise InputError(
            f"nothing to plot in {brief(what)}; expected plans, a trade-off, or a Monte Carlo."
        )
    if points:
        scenario = points[0].plan.scenario
        title = f"{scenario.headline}, arcs of {scenario.problem.time_step:g} s"
        return Plot(tradeoff_figure(points, knee_of(points), title))
    asked = plans[0].scenario
    for k, one in enumerate(plans):
        if not _alike(one.scenario, asked):
            raise InputError(
                f"plans 0 and {k} have other states at their ends, or another collision_radius; "
                "expected plans of one scenario: plot each scenario's by themselves."
            )
    title = asked.name or f"{asked.n} craft"
    radius = asked.problem.collision_radius
    return Plot(transfer_figure(Example(title, asked.initial, asked.goal, _tracks(plans), radius)))


def _alike(one: Scenario, other: Scenario) -> bool:
    """Whether scenarios have the same collision radius, starts, and goals in any order."""
    return (
        one.problem.collision_radius == other.problem.collision_radius
        and np.array_equal(one.initial, other.initial)
        and sorted(one.goal.tolist()) == sorted(other.goal.tolist())
    )


def _tracks(plans: Sequence[Plan]) -> Mapping[str, Float[Array, "n _ 3"]]:
    """Positions along each plan, by label: its planner, numbered where there are several."""
    seen: Counter[str] = Counter()
    tracks = {}
    for one in plans:
        seen[one.planner] += 1
        name = label_name(one.planner)
        label = name if seen[one.planner] == 1 else f"{name} ({seen[one.planner]})"
        tracks[label] = track(one.states, one.controls, one.scenario.problem, STEPS)
    return tracks


def convert(
    plan: Plan,
    to: Literal["oem", "opm", "csv", "parquet", "burns", "basilisk"],
    path: str | Path,
    *,
    mass: float | Sequence[float] | None = None,
    specific_impulse: float | Sequence[float] | None = None,
) -> list[Path]:
    """Write a plan in a format that other tools read, and return the files.

    Args:
        plan: the plan.
        to: oem and opm, CCSDS orbit ephemeris and parameter messages in EME2000, go into a folder,
            a file a craft, and the scenario needs a ``reference``; csv and parquet have a row for
            each craft and node, burns has one for each craft and interval with thrust; basilisk is
            a Python script that flies them in this simulator, of a scenario with an ``orbit`` or a
            ``reference``.
        path: of the file or folder.
        mass: of the craft at the first node, kg, one for all or one for each; by default the
            scenario's. For burns, basilisk and opm.
        specific_impulse: of their thrusters, s, one for all or one for each; for burns and opm. An
            opm with burns needs masses and this.

    Raises:
        InputError: for a plan that cannot be written so, or masses that are not used.
    """
    from pipeline.export import write_plan_as

    check_kind("plan", plan, Plan)
    target = path_of(path)
    with missing_extra_hint():
        return write_plan_as(
            to, plan, target, target.name, mass=mass, specific_impulse=specific_impulse
        )
