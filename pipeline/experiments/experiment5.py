"""Experiment 5: close approaches, errors at the goal and Δv of plans that are flown."""

from collections.abc import Mapping

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter

from pipeline.experiments import averages, records
from pipeline.experiments.averages import average
from pipeline.experiments.records import LOOPS, NO_ERRORS, OPEN, TYPICAL, WITH_ERRORS, WORLDS
from pipeline.experiments.verdicts import ANY, DECOUPLED, SAFE, Finding, Rules, decide
from pipeline.figures import labels
from pipeline.figures.intervals import at_most, clustered_interval
from pipeline.figures.labels import called, error, number, ratio, share
from pipeline.figures.style import GREY, PAGE_WIDTH, Style, fit_scale, in_style
from pipeline.figures.tables import Column, Picture, Section, Table
from pipeline.flight.trials import SIZE

CONDITION = ["world", "errors", "loop"]  # columns that say how a plan was flown


LOW, HIGH = "within_radius_low", "within_radius_high"
WITHIN_RADIUS = average("Within r_col", "within_radius_share", share, "within_radius", wilson=True)
WITHIN_SIZE = average("Within size", "within_size_share", share, "within_size", wilson=True)
GOAL = average("Off goal, median (m)", "goal_error_median", error, "goal_error", "median")
GOAL_HIGH = average("95 % (m)", "goal_error_high", error, "goal_error", lambda v: v.quantile(0.95))
VELOCITY = average(
    "Velocity off, median (m/s)", "goal_velocity_median", number, "goal_velocity_error", "median"
)
DELTA_V = average("Δv / bound, av.", "delta_v_ratio", ratio, "delta_v_ratio")
MOST_DELTA_V = average("Δv / bound, max.", "delta_v_most", ratio, "delta_v_ratio", "max", "max")
NO_PLAN = average("No safe plan", "no_plan_share", share, "no_plan")
MARGIN = average("Margin, av. (m)", "margin_mean", number, "margin")

SHARES = (WITHIN_RADIUS, WITHIN_SIZE)
AVERAGES = (
    *(*SHARES, averages.SEPARATION, GOAL, GOAL_HIGH, VELOCITY),
    *(DELTA_V, MOST_DELTA_V, NO_PLAN, MARGIN),
)

CONDITIONS = [Column(name.capitalize(), name) for name in CONDITION]

COLUMNS = [
    *(Column("Planner", "name"), Column("Recipe", "recipe"), *CONDITIONS[1:], WITHIN_SIZE),
    *(averages.SEPARATION, GOAL, GOAL_HIGH, DELTA_V, MOST_DELTA_V, NO_PLAN),
]
"""Columns of what else became of the flights about the usual low orbit."""


def section(flights: pd.DataFrame, look: Mapping[str, Style]) -> Section:
    """The verdict on all planners, the figure and both tables."""
    template = "pipeline/experiments/experiment5.md.jinja"
    if flights.empty:
        return Section(template, {"flown": None})
    summary = summarize_flights(flights)
    coordinated = summary[~summary["planner"].isin(list(labels.BASELINES))]
    values = {
        "flown": {"n": int(flights["n"].iloc[0]), "each": int(flights["flight"].max()) + 1},
        "trials": int(summary["trials"].max()),
        "most": share(1 - SAFE),
        "typical": TYPICAL,
        "size": SIZE,
        "margin": coordinated.loc[coordinated["loop"] == LOOPS[-1], MARGIN.source].mean(),
        "picture": Picture("experiment5", flights_figure(summary, look)),
        "within": within_table(summary),
        "conditions": conditions_table(summary),
    }
    return Section(template, values)


def within_table(summary: pd.DataFrame) -> Table:
    """Flights in which a pair comes within r_col: a row a condition, a column a planner."""
    names = list(map(called, summary["planner"], summary["recipe"]))
    rows, printed = summary.assign(label=names), {name: name for name in names}
    frame, columns = averages.wide(rows, CONDITION, "label", WITHIN_RADIUS, printed)
    return Table("experiment5-within", frame, [*CONDITIONS, *columns])


def conditions_table(summary: pd.DataFrame) -> Table:
    """All averages in all conditions; the page shows one world of them."""
    printed = summary["world"] == TYPICAL
    return Table("experiment5", averages.named(summary), COLUMNS, printed=printed)


def summarize_flights(flights: pd.DataFrame) -> pd.DataFrame:
    """Averages over the flights of each planner and recipe in each condition, in reading order.

    Rows have columns planner, recipe, ``CONDITION``, seeds, trials (scenarios) and those of
    ``AVERAGES``. Intervals are ``clustered_interval``'s, since flights of one scenario are alike.
    """
    group = ["planner", "recipe", *CONDITION]
    bound, unsafe = (flights[name].astype(float) for name in ("delta_v_bound", "unsafe_replans"))
    rows = flights.assign(
        recipe=flights["recipe"].fillna(""),
        within_radius=flights["within_radius"].astype(float),
        within_size=flights["within_size"].astype(float),
        delta_v_ratio=flights["delta_v"].astype(float) / bound.where(bound > averages.NO_FUEL),
        no_plan=(unsafe > 0).astype(float).where(unsafe.notna()),
    )
    order = dict(zip(CONDITION, (WORLDS, records.ERRORS, LOOPS), strict=True))
    summary = averages.averaged(rows, group, AVERAGES, order)
    for one in SHARES:
        found = rows.groupby([*group, "trial"])[one.of].agg(["mean", "size"]).groupby(group)
        intervals = {
            key: clustered_interval(part["mean"].to_numpy(), int(part["size"].max()))
            for key, part in found
        }
        keys = summary[group].itertuples(index=False, name=None)
        summary[list(one.interval or ())] = [intervals[key] for key in keys]
    return summary


WIDTH = 0.62  # of the room that the planners of one loop share, where loops are 1 apart
BOTTOM = 0.003  # least error at the goal that is shown, m; the linear world without errors has none


@in_style
def flights_figure(summary: pd.DataFrame, look: Mapping[str, Style]) -> Figure:
    """A column of panels for each world; markers by planner and loop, hollow without errors."""
    worlds = [world for world in WORLDS if world in set(summary["world"])]
    figure = Figure(figsize=(PAGE_WIDTH, 6.6), layout="constrained")
    panels = figure.subplots(3, len(worlds), sharex=True, sharey="row", squeeze=False)
    drawn = {
        WITHIN_RADIUS.title: (WITHIN_RADIUS.source, LOW, HIGH),
        "off goal, median to 95 % (m)": (GOAL.source, GOAL.source, GOAL_HIGH.source),
        DELTA_V.title: (DELTA_V.source,),
    }
    for line, (label, sources) in zip(panels, drawn.items(), strict=True):
        line[0].set_ylabel(label)
        for ax, world in zip(line, worlds, strict=True):
            _markers(ax, summary[summary["world"] == world], look, *sources)
            ax.grid(visible=False, axis="x")
    for ax, world in zip(panels[0], worlds, strict=True):
        ax.set_title(f"{world} world" if world == WORLDS[0] else f"nonlinear, {world}")
    near, goal, dear = panels[:, 0]
    near.set_ylim(-0.03, max(0.1, 1.1 * float(summary[HIGH].max())))
    near.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    fit_scale(goal, "y", [v for v in summary[GOAL_HIGH.source] if v > BOTTOM], log=True)
    goal.set_ylim(bottom=BOTTOM)
    dear.set_xticks(range(len(LOOPS)), LOOPS)
    dear.set_xlim(-0.5, len(LOOPS) - 0.5)
    handles = averages.planner_handles(summary["planner"], look)
    for handle in handles:
        handle.set_linestyle("none")
    handles += [
        Line2D([], [], linestyle="none", marker="o", color=GREY, markerfacecolor=face, label=label)
        for label, face in {"with errors": GREY, "without errors": "white"}.items()
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=6)
    return figure


def _markers(
    ax: Axes, rows: pd.DataFrame, look: Mapping[str, Style], source: str, *ends: str
) -> None:
    """A marker for each row at its loop, planners side by side; with errors also its interval."""
    shown = list(dict.fromkeys(zip(rows["planner"], rows["recipe"], strict=True)))
    step = WIDTH / max(1, len(shown))
    for row in rows.to_dict("records"):
        planner, hollow = str(row["planner"]), row["errors"] == NO_ERRORS
        place = shown.index((planner, str(row["recipe"]))) - (len(shown) - 1) / 2
        at = LOOPS.index(str(row["loop"])) + step * place
        style = look[planner]
        if ends and not hollow:
            ax.vlines(at, *(row[end] for end in ends), color=style.colour, linewidth=0.9)
        ax.plot(
            at,
            float(row[source]),
            marker=style.marker,
            linestyle="none",
            color=style.colour,
            markerfacecolor="white" if hollow else style.colour,
            markersize=4.2,
            alpha=0.6 if hollow else 1.0,  # some markers have no face
            zorder=3,
        )


HOLDS: Rules = (
    ((True, ANY, ANY), "Yes, as they stand"),
    ((ANY, True, ANY), "Yes, made anew at every node"),
    ((ANY, ANY, True), "Only made anew at every node with a margin"),
    ((False, False, False), "No, not even made anew with a margin"),
    ((False, ANY, ANY), "Not as they stand; else too few scenarios"),
    ((ANY, ANY, ANY), "Open: too few scenarios"),
)
"""By whether plans hold in each of LOOPS: a pair comes within r_col in few enough flights."""


def findings(flights: pd.DataFrame) -> list[Finding]:
    """Whether plans hold when flown, for each planner that keeps craft apart.

    They do where a pair comes within the collision radius in no more than 1 - SAFE of flights,
    by the whole interval, in the world of TYPICAL with errors.
    """
    if flights.empty:
        return []
    summary = summarize_flights(flights)
    typical = summary[summary["world"] == TYPICAL]
    rough = typical[typical["errors"] == WITH_ERRORS]
    undisturbed = typical[(typical["errors"] == NO_ERRORS) & (typical["loop"] == OPEN)]
    free = rough[rough["planner"] == DECOUPLED]
    beside = f"Decoupled optimum: {_shares(free)}" if len(free) else ""
    found = []
    for (planner, recipe), rows in rough.groupby(["planner", "recipe"], sort=False):
        if planner in labels.BASELINES:
            continue
        same = (undisturbed["planner"] == planner) & (undisturbed["recipe"] == recipe)
        ends = rows.set_index("loop")[[LOW, HIGH]].reindex(list(LOOPS))  # open where not flown
        holds = [at_most(interval, 1 - SAFE) for interval in ends.itertuples(index=False)]
        who = labels.in_sentence(str(planner))
        question = f"Do {who}'s plans hold outside the linear model, with errors?"
        shares = f"{_shares(rows)}; without errors {_shares(undisturbed[same])}"
        numbers = f"{called(str(planner), str(recipe))}, within r_col: {shares}"
        found.append(Finding(question, decide(HOLDS, *holds), numbers, beside))
    return found


def _shares(rows: pd.DataFrame) -> str:
    """In each loop, the share of flights in which a pair came within the collision radius."""
    return ", ".join(
        f"{share(value)} {labels.percents(low, high)} {'in ' if loop == OPEN else ''}{loop}"
        for loop, value, low, high in rows[["loop", WITHIN_RADIUS.source, LOW, HIGH]].itertuples(
            index=False
        )
    )
