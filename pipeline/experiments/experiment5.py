"""Experiment 5: close approaches, errors at the goal and Δv of plans that are flown."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter

from pipeline.experiments import averages, records
from pipeline.experiments.averages import PLANNER, RECIPE, N, average
from pipeline.experiments.records import AS_FLOWN, LINEAR, LOOPS, NO_ERRORS, TYPICAL
from pipeline.experiments.verdicts import ANY, DECOUPLED, SAFE, Finding, Rules, decide
from pipeline.figures import labels
from pipeline.figures.intervals import at_most, clustered_interval
from pipeline.figures.labels import error, number, planner_label, ratio, share
from pipeline.figures.style import GREY, PAGE_WIDTH, Style, fit_scale, in_style
from pipeline.figures.tables import Column, Picture, Section, Table
from pipeline.flight import FEEDBACK, OPEN
from pipeline.flight.trials import SIZE

CONDITION = ["world", "errors", "loop"]  # columns that identify how a plan was flown
SWARM = ["planner", "recipe", "n"]  # columns that identify whose plan it is

ARRIVED = 1e-5  # largest distance from a goal at which it counts as met, m

LOW, HIGH = "within_radius_low", "within_radius_high"
WITHIN_RADIUS = average("Within r_col", "within_radius_share", share, "within_radius", wilson=True)
WITHIN_SIZE = average("Within size", "within_size_share", share, "within_size", wilson=True)
GOAL = average("Off goal, median (m)", "goal_error_median", error, "goal_error", "median")
GOAL_HIGH = average("95 % (m)", "goal_error_high", error, "goal_error", lambda v: v.quantile(0.95))
GOAL_MOST = average("Largest (m)", "goal_error_most", error, "goal_error", "max", "max")
VELOCITY = average(
    "Velocity off, median (m/s)", "goal_velocity_median", number, "goal_velocity_error", "median"
)
DELTA_V = average("Δv / bound, av.", "delta_v_ratio", ratio, "delta_v_ratio")
MOST_DELTA_V = average("Δv / bound, max.", "delta_v_most", ratio, "delta_v_ratio", "max", "max")
OVER_LINEAR = average("Δv / linear plan's, av.", "over_linear_mean", ratio, "over_linear")
NO_PLAN = average("No safe plan", "no_plan_share", share, "no_plan")

SHARES = (WITHIN_RADIUS, WITHIN_SIZE)
AVERAGES = (
    *(*SHARES, averages.SEPARATION, GOAL, GOAL_HIGH, GOAL_MOST, VELOCITY),
    *(DELTA_V, MOST_DELTA_V, OVER_LINEAR, NO_PLAN),
)

CONDITIONS = [N, *(Column(name.capitalize(), name) for name in CONDITION)]

COLUMNS = [
    *(N, PLANNER, RECIPE, *CONDITIONS[2:], WITHIN_SIZE),
    *(averages.SEPARATION, GOAL, GOAL_HIGH, DELTA_V, MOST_DELTA_V, NO_PLAN),
]
"""Columns of the table of all other averages, about the usual low orbit."""

PLANNED_COLUMNS = [
    *(N, Column("Orbit", "world"), Column("Planned", "planned"), PLANNER, RECIPE),
    *(WITHIN_RADIUS, averages.SEPARATION, GOAL, GOAL_MOST, OVER_LINEAR),
]
"""Columns of the table of flights without errors: linear plans beside plans as flown."""


def section(flights: pd.DataFrame, styles: Mapping[str, Style]) -> Section:
    """Figures and tables of the flights, and of plans made as flown if there are any."""
    template = "pipeline/experiments/experiment5.md.jinja"
    if flights.empty:
        return Section(template, {"trials": ""})
    summary = in_loops(summarize_flights(flights))
    planned = in_both_models(summarize_flights(where_solved_as_flown(flights)))
    values = {
        "each": int(flights["flight"].max()) + 1,
        "trials": _trials(summary),
        "planned": None if planned.empty else planned_values(flights, planned, styles),
        "most": share(1 - SAFE),
        "typical": TYPICAL,
        "size": SIZE,
        "risk": records.RISK,
        "picture": Picture("experiment5", flights_figure(summary, styles)),
        "within": within_table(summary),
        "conditions": conditions_table(summary),
    }
    return Section(template, values)


def planned_values(
    flights: pd.DataFrame, summary: pd.DataFrame, styles: Mapping[str, Style]
) -> dict[str, Any]:
    """Template values that compare plans made as flown with plans for the linear model."""
    *shapes, last = (f"{records.ORBITS[world]:g}" for world in dict.fromkeys(summary["world"]))
    return {
        "claim": _claim(flights),
        "trials": _trials(summary),
        "orbits": " and ".join(filter(None, (", ".join(shapes), last))),
        "picture": Picture("experiment5-as-flown", planned_figure(summary, styles)),
        "table": Table("experiment5-as-flown", averages.with_names(summary), PLANNED_COLUMNS),
    }


def _trials(summary: pd.DataFrame) -> str:
    sizes = summary.groupby("n")["trials"].max()
    return " and ".join(f"{trials:,} of n = {n}" for n, trials in sizes.items())


def in_loops(summary: pd.DataFrame) -> pd.DataFrame:
    """Rows that compare the loops: flights with feedback, and of plans for the linear model.

    Worlds in which nothing was flown with feedback are left out.
    """
    chosen = (summary["planned"] == LINEAR) | (summary["loop"] == FEEDBACK)
    key = ["n", "world"]
    worlds = summary.loc[summary["loop"] == FEEDBACK, key].drop_duplicates()
    return summary[chosen].merge(worlds, on=key)


def in_both_models(rows: pd.DataFrame) -> pd.DataFrame:
    """Flights without errors in open loop, where plans were made for both models."""
    key = [*SWARM, "world"]
    rows = rows[(rows["errors"] == NO_ERRORS) & (rows["loop"] == OPEN)]
    both = rows.loc[rows["planned"] == AS_FLOWN, key].drop_duplicates()
    return rows.merge(both, on=key)


def where_solved_as_flown(flights: pd.DataFrame) -> pd.DataFrame:
    """Flights of those scenarios and worlds for which the plan as flown is solved.

    One that is not may exceed limits of thrust, and there may be none that does not. Tables of
    earlier versions do not say which are solved.
    """
    key = pd.MultiIndex.from_frame(flights[[*SWARM, "training_seed", "trial", "world"]])
    as_flown = (flights["planned"] == AS_FLOWN) & (flights["loop"] == OPEN)
    unsolved = as_flown & (flights["unsafe_replans"].astype(float) > 0)
    return flights[~key.isin(key[unsolved])]


def within_table(summary: pd.DataFrame) -> Table:
    """Flights with a pair within r_col: a row for each condition, a column for each planner."""
    names = list(map(planner_label, summary["planner"], summary["recipe"]))
    rows, printed = summary.assign(label=names), {name: name for name in names}
    key = ["n", *CONDITION]
    frame, columns = averages.pivot_average(rows, key, "label", WITHIN_RADIUS, printed)
    return Table("experiment5-within", frame, [*CONDITIONS, *columns])


def conditions_table(summary: pd.DataFrame) -> Table:
    """All averages in all conditions; the page shows those of TYPICAL."""
    printed = summary["world"] == TYPICAL
    return Table("experiment5", averages.with_names(summary), COLUMNS, printed=printed)


def summarize_flights(flights: pd.DataFrame) -> pd.DataFrame:
    """Averages over the flights of each planner and recipe in each condition, in reading order.

    Rows have columns ``SWARM``, planned, ``CONDITION``, seeds, trials (scenarios) and those of
    ``AVERAGES``. Intervals are ``clustered_interval``'s: flights of one scenario are correlated.
    """
    group, plan = [*SWARM, *CONDITION, "planned"], [*SWARM, "training_seed", "trial"]
    columns = ("delta_v", "delta_v_bound", "within_radius", "within_size", "unsafe_replans")
    rows = flights.astype(dict.fromkeys(columns, float))
    bound, unsafe = rows["delta_v_bound"], rows["unsafe_replans"]
    rows = rows.assign(
        delta_v_ratio=rows["delta_v"] / bound.where(bound > averages.NEGLIGIBLE_FUEL),
        no_plan=(unsafe > 0).astype(float).where(unsafe.notna()),
    )
    linear = rows[(rows["planned"] == LINEAR) & (rows["errors"] == NO_ERRORS)]
    linear = linear[linear["loop"] == OPEN].groupby(plan)[["delta_v"]].first()  # in any world
    rows["over_linear"] = rows["delta_v"] / rows[plan].join(linear, on=plan)["delta_v"]
    order = dict(zip(CONDITION, ((LINEAR, *records.ORBITS), records.ERRORS, LOOPS), strict=True))
    order["planned"] = records.PLANNED
    summary = averages.aggregate(rows, group, AVERAGES, order)
    for one in SHARES:
        found = rows.groupby([*group, "trial"])[one.column].agg(["mean", "size"]).groupby(group)
        intervals = {
            key: clustered_interval(part["mean"].to_numpy(), int(part["size"].max()))
            for key, part in found
        }
        keys = summary[group].itertuples(index=False, name=None)
        summary[list(one.interval or ())] = [intervals[key] for key in keys]
    return summary


WIDTH = 0.62  # of all planners' markers at one tick; ticks are 1 apart
# Lower end of the axis of errors at the goal, m: in the linear world they may be zero
BOTTOM = 0.003


@in_style
def flights_figure(summary: pd.DataFrame, styles: Mapping[str, Style]) -> Figure:
    """A column of panels for each n and world; markers by planner, hollow without errors."""
    exact = summary["errors"] == NO_ERRORS
    rows = summary.assign(at=summary["loop"].map(LOOPS.index), hollow=exact, ranged=~exact)
    parts = rows.groupby(["n", "world"], sort=False)
    shown = {f"n = {n}, {world}": some for (n, world), some in parts}
    drawn = {
        WITHIN_RADIUS.title: (WITHIN_RADIUS.source, LOW, HIGH),
        "off goal, median to 95 % (m)": (GOAL.source, GOAL.source, GOAL_HIGH.source),
        DELTA_V.title: (DELTA_V.source,),
    }
    figure, panels = _markers_figure(shown, drawn, styles, ("with errors", "without errors"))
    fit_scale(panels[1, 0], "y", [v for v in summary[GOAL_HIGH.source] if v > BOTTOM], log=True)
    panels[1, 0].set_ylim(bottom=BOTTOM)
    for ax in panels[2]:
        slanted = {"rotation": 40, "horizontalalignment": "right", "rotation_mode": "anchor"}
        ax.set_xticks(range(len(LOOPS)), LOOPS, **slanted)
    panels[2, 0].set_xlim(-0.5, len(LOOPS) - 0.5)
    return figure


@in_style
def planned_figure(summary: pd.DataFrame, styles: Mapping[str, Style]) -> Figure:
    """A column of panels for each n; markers by planner and orbit, hollow for linear plans."""
    orbits = list(dict.fromkeys(summary["world"]))
    linear = summary["planned"] == LINEAR
    rows = summary.assign(at=summary["world"].map(orbits.index), hollow=linear, ranged=True)
    shown = {f"n = {n}": some for n, some in rows.groupby("n")}
    drawn = {
        WITHIN_RADIUS.title: (WITHIN_RADIUS.source, LOW, HIGH),
        "off goal, median to largest (m)": (GOAL.source, GOAL.source, GOAL_MOST.source),
        OVER_LINEAR.title: (OVER_LINEAR.source,),
    }
    faces = ("planned as flown", "planned in the linear model")
    figure, panels = _markers_figure(shown, drawn, styles, faces)
    fit_scale(panels[1, 0], "y", [*summary[GOAL.source], *summary[GOAL_MOST.source]], log=True)
    low, high = panels[1, 0].get_ylim()
    panels[1, 0].set_ylim(low / 3, 3 * high)
    panels[2, 0].set_xticks(range(len(orbits)), orbits)
    panels[2, 0].set_xlim(-0.5, len(orbits) - 0.5)
    return figure


def _markers_figure(
    shown: Mapping[str, pd.DataFrame],
    drawn: Mapping[str, tuple[str, ...]],
    styles: Mapping[str, Style],
    faces: tuple[str, str],
) -> tuple[Figure, Any]:
    """Panels with a marker for each row of a summary; the first row of panels has shares.

    A column of panels for each title in ``shown``, whose rows have columns ``at`` (abscissa),
    ``hollow`` and ``ranged``; a row for each label in ``drawn``, with source and ends as for
    ``_markers``. ``faces`` are the labels of filled and hollow markers.
    """
    figure = Figure(figsize=(PAGE_WIDTH, 6.6), layout="constrained")
    panels = figure.subplots(len(drawn), len(shown), sharex=True, sharey="row", squeeze=False)
    for line, (label, sources) in zip(panels, drawn.items(), strict=True):
        line[0].set_ylabel(label)
        for ax, rows in zip(line, shown.values(), strict=True):
            _markers(ax, rows, styles, *sources)
            ax.grid(visible=False, axis="x")
    for ax, title in zip(panels[0], shown, strict=True):
        ax.set_title(title)
    every = pd.concat(shown.values())
    panels[0, 0].set_ylim(-0.03, max(0.1, 1.1 * float(every[HIGH].max())))
    panels[0, 0].yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    handles = averages.planner_handles(every["planner"], styles)
    for handle in handles:
        handle.set_linestyle("none")
    handles += [
        Line2D([], [], linestyle="none", marker="o", color=GREY, markerfacecolor=face, label=label)
        for label, face in zip(faces, (GREY, "white"), strict=True)
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=5)
    return figure, panels


def _markers(
    ax: Axes, rows: pd.DataFrame, styles: Mapping[str, Style], source: str, *ends: str
) -> None:
    """A marker for each row, planners side by side; a range between ends where ``ranged``."""
    shown = list(dict.fromkeys(zip(rows["planner"], rows["recipe"], strict=True)))
    step = WIDTH / max(1, len(shown))
    for row in rows.to_dict("records"):
        planner, hollow = str(row["planner"]), bool(row["hollow"])
        place = shown.index((planner, str(row["recipe"]))) - (len(shown) - 1) / 2
        at = float(row["at"]) + step * place
        style = styles[planner]
        alpha = 0.6 if hollow else 1.0  # as hollow does not show on every marker
        if ends and row["ranged"]:
            low, high = (row[end] for end in ends)
            ax.vlines(at, low, high, color=style.colour, linewidth=0.9, alpha=alpha)
        ax.plot(
            at,
            float(row[source]),
            marker=style.marker,
            linestyle="none",
            color=style.colour,
            markerfacecolor="white" if hollow else style.colour,
            markersize=4.2,
            alpha=alpha,
            zorder=3,
        )


HOLDS: Rules = (
    ((True, ANY, ANY, ANY), "Yes, in open loop"),
    ((ANY, ANY, True, ANY), "Yes, replanned at every node"),
    ((False, True, False, True), "Only with feedback and a risk limit, or replanned with a margin"),
    ((False, True, False, False), "Only with feedback and a risk limit"),
    ((False, False, False, True), "Only replanned at every node with a margin"),
    ((False, False, False, False), "No, not even with feedback or a margin"),
    ((None, None, None, None), "Open: too few scenarios"),
    ((ANY, True, ANY, True), "With feedback and a risk limit, or replanned with a margin{rest}"),
    ((ANY, True, ANY, ANY), "With feedback and a risk limit{rest}"),
    ((ANY, ANY, ANY, True), "Replanned at every node with a margin{rest}"),
    ((ANY, ANY, ANY, ANY), "Not {failed}; otherwise too few scenarios"),
)
"""By whether plans hold in each of LOOPS: in few enough flights a pair comes within r_col."""


def _verdict(holds: Sequence[bool | None]) -> str:
    """The verdict of HOLDS, with the loops in which plans do not hold."""
    failed = " or ".join(SAID[loop] for loop, one in zip(LOOPS, holds, strict=True) if one is False)
    rest = f"; not {failed}" if failed else ""
    rest += "; otherwise too few scenarios"
    return decide(HOLDS, *holds).format(failed=failed, rest=rest)


def findings(flights: pd.DataFrame) -> Iterator[Finding]:
    """Whether plans hold when flown, for each planner that keeps craft apart.

    They do where a pair comes within the collision radius in no more than 1 - SAFE of flights,
    by the whole interval, in the world of TYPICAL with errors.
    """
    if flights.empty:
        return
    summary = in_loops(summarize_flights(flights))
    typical = summary[summary["world"] == TYPICAL]
    with_errors = typical[typical["errors"] == records.WITH_ERRORS]
    without_errors = typical[(typical["errors"] == NO_ERRORS) & (typical["loop"] == OPEN)]
    for (n, planner, recipe), rows in with_errors.groupby(["n", "planner", "recipe"], sort=False):
        if planner in labels.BASELINES:
            continue
        same = (without_errors[["n", "planner", "recipe"]] == [n, planner, recipe]).all(axis=1)
        ends = rows.set_index("loop")[[LOW, HIGH]].reindex(list(LOOPS))  # open where not flown
        holds = [at_most(interval, 1 - SAFE) for interval in ends.itertuples(index=False)]
        who = labels.name_in_sentence(str(planner))
        question = f"Do {who}'s plans of n = {n} hold outside the linear model, with errors?"
        decoupled = with_errors[(with_errors["planner"] == DECOUPLED) & (with_errors["n"] == n)]
        baseline = f"Decoupled optimum: {_shares(decoupled)}" if len(decoupled) else ""
        shares = f"{_shares(rows)}; without errors {_shares(without_errors[same])}"
        numbers = f"{planner_label(str(planner), str(recipe))}, within r_col: {shares}"
        yield Finding(question, _verdict(holds), numbers, baseline)
    yield from _as_flown_findings(flights)


HOLD_AS_FLOWN: Rules = (
    ((True, True, True), "Yes, without errors"),
    ((True, True, False), "Yes, without errors, where there is one"),
    ((True, False, ANY), "Safe, but not at their goals"),
    ((False, True, ANY), "At their goals, but not safe"),
    ((False, False, ANY), "No"),
)
"""Verdicts on plans as flown: no pair within r_col, all goals met, all plans solved."""


def _as_flown_findings(flights: pd.DataFrame) -> Iterator[Finding]:
    """Whether plans made as flown hold without errors, for each planner that makes any.

    They do where in no flight of a solved plan a pair comes within the collision radius, or a craft
    ends further than ``ARRIVED`` from its goal.
    """
    for (planner, recipe), every in in_both_models(flights).groupby(
        ["planner", "recipe"], sort=False
    ):
        solved = where_solved_as_flown(every)
        flown = solved[solved["planned"] == AS_FLOWN]
        if flown.empty:
            continue
        apart, met = not flown["within_radius"].any(), flown["goal_error"].max() <= ARRIVED
        holds = bool(apart), bool(met), len(solved) == len(every)
        who = labels.name_in_sentence(str(planner))
        question = f"Do {who}'s plans hold outside the linear model if planned as flown?"
        text = f"{planner_label(str(planner), str(recipe))}: {_claim(every)}"
        yield Finding(question, decide(HOLD_AS_FLOWN, *holds), text)


def _claim(flights: pd.DataFrame) -> str:
    """Close approaches and errors at goals of plans as flown and of linear plans, as text."""
    every = in_both_models(flights)
    by_model = {
        planned: (int(some["within_radius"].sum()), len(some), some["goal_error"].max())
        for planned, some in where_solved_as_flown(every).groupby("planned")
    }
    unsafe, plans, miss = by_model[AS_FLOWN]
    unsafe_linear, plans_linear, miss_linear = by_model[LINEAR]
    close = f"{unsafe:,} of {plans:,} plans have" if unsafe else f"none of {plans:,} plans has"
    goals = f"goals are missed by at most {number(miss)} m"
    left_out = int((every["planned"] == AS_FLOWN).sum()) - plans
    rest = f"; {left_out:,} without a plan as flown are left out" if left_out else ""
    return (
        f"planned as flown, {close} a pair within r_col, and {goals}; planned in the linear "
        f"model, {share(unsafe_linear / plans_linear)} have one, and goals are missed by up to "
        f"{number(miss_linear)} m{rest}"
    )


SAID = dict(zip(LOOPS, ("in open loop", "with feedback", *LOOPS[2:]), strict=True))


def _shares(rows: pd.DataFrame) -> str:
    """In each loop, the share of flights in which a pair came within the collision radius."""
    columns = rows[["loop", WITHIN_RADIUS.source, LOW, HIGH]].itertuples(index=False)
    return ", ".join(
        f"{share(value)} {labels.percents(low, high)} {SAID[loop]}"
        for loop, value, low, high in columns
    )
