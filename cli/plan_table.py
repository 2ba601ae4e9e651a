"""The table of plans: planner, fuel, optimality gap and closest pair of each."""

from collections.abc import Iterator, Mapping, Sequence
from math import degrees, inf
from pathlib import Path
from typing import Any

from cli.output import echo, note, print_table
from pipeline.figures.labels import MISSING, number
from pipeline.files import STDIO
from pipeline.text import as_argument

Row = Mapping[str, Any]  # a plan's summary, its files, and the error of the linear model
MOST_CRAFT = 12  # craft of a plan up to which the Δv of each is shown
CLOSEST = ("closest\npair", "at\ns", "apart\nm")  # headings of ``closest_cells``
HEADINGS = ("planner", "fuel\nm/s²", "Δv all\nm/s", "gap", *CLOSEST, "time\nms")
SIGNED = "apart with a sign: clearance beyond the required separation."


def plan_cells(row: Row) -> list[str]:
    """The cells of a plan under HEADINGS."""
    gap, planner = row["optimality_gap"], row["planner"]
    return [
        f"{planner} ({row['status']})" if is_unsolved(row) else planner,
        number(row["fuel"]),
        number(row["delta_v"]),
        MISSING if gap is None or not 0 <= gap < inf else f"{gap:z.2%}",
        *closest_cells(row),
        number(1e3 * row["seconds"]),
    ]


def print_rows(
    headings: Sequence[str], lines: Sequence[Sequence[str]], rows: Sequence[Row]
) -> None:
    """Print a table whose first columns are texts; plans that must not be flown are marked."""
    marked = [k for k, row in enumerate(rows) if is_unsolved(row)]
    print_table(headings, lines, texts=(0, 1), marked=marked)


def closest_cells(row: Row) -> list[str]:
    """The pair that comes closest, when (s), and how close (m); by sizes where these differ."""
    if clear := row.get("clearance"):
        who = f"{clear['craft']},{clear['other']}"
        return [who, f"{clear['time']:.0f}", f"{clear['min_clearance']:+.2f}"]
    pair = row["min_separation_pair"]
    if pair is None:
        return [MISSING] * 3
    at, apart = row["min_separation_time"], row["min_separation"]
    return [f"{pair[0]},{pair[1]}", f"{at:.0f}", f"{apart:.2f}"]


def print_plans(rows: Sequence[Row]) -> None:
    """Print the table of plans, remarks on single ones, and where their files are."""
    headings = ["scenario", *HEADINGS]
    lines = [[Path(row["scenario"]).stem, *plan_cells(row)] for row in rows]
    for name, (names, extra) in EXTRA.items():
        if any(row[name] for row in rows):
            headings += names
            for row, line in zip(rows, lines, strict=True):
                line += extra(row) if row[name] else [MISSING] * len(names)
    print_rows(headings, lines, rows)
    if len(rows) == 1:
        _print_craft(rows[0])
    for row in rows:
        for sentence in _remarks(row):
            echo(f"{row['scenario']}: {sentence}")
    note(*_legend(rows))
    worlds = {orbit_in_words(row["world"]) for row in rows if row["world"]}
    if worlds:
        note(f"As flown: {worlds.pop() if len(worlds) == 1 else 'each about its own orbit.'}")
    where = Path(rows[0]["plan"])
    if where != STDIO:
        echo(f"The plans are in {where.parent}/." if rows[1:] else f"The plan is {where}.")


def _legend(rows: Sequence[Row]) -> Iterator[str]:
    if risks := [row["risk"] for row in rows if row["risk"]]:
        added = " + what corrections add" if any(one["feedback"] for one in risks) else ""
        yield f"safety costs: fuel that keeping the risk adds to the plan without it{added}."
    if assigned := [row["assignment"] for row in rows if row["assignment"]]:
        most = max(one["tried"] for one in assigned)
        yield (
            "saved: against any plan for the given order of goals, of its fuel. "
            f"Assignments tried: {most}{' at most' if len(rows) > 1 else ''}."
        )
    if adrift := [row["passive_safety"] for row in rows if row["passive_safety"]]:
        yield (
            "adrift from: who comes closest to another after a loss of thrust, and the node of the "
            f"loss. Orbits of drift: {adrift[0]['orbits']:g}."
        )
    if any(row.get("clearance") for row in rows):
        yield SIGNED
    if any(row["largest_share"] for row in rows):
        yield "largest share: that a craft burns of its delta_v; ≥: a lower bound for any plan."
    if any(row["smallest_burn"] for row in rows):
        yield (
            "least: the smallest burn of a thruster. bit costs: fuel that min_delta_v adds to the "
            "planner's own plan without it."
        )


def orbit_in_words(of: Mapping[str, Any]) -> str:
    """A line with the mean elements of a reference orbit and its perturbations."""
    from pipeline.orbit.reference_orbit import ReferenceOrbit

    mean = ReferenceOrbit(**of).mean_elements
    ballistic, j2 = of["ballistic"], "with" if of["j2"] else "without"
    drag = f"drag of {ballistic:g} m²/kg ± {of['spread']:.0%}" if ballistic else "without drag"
    orbit = (
        f"mean eccentricity {mean.eccentricity:.4g}, inclination {degrees(mean.inclination):.5g}°"
    )
    return f"{orbit}, {j2} J2, {drag}."


def _print_craft(row: Row) -> None:
    """Print what each craft of a plan spends, or, of many, the range."""
    columns = [
        ("Δv ‖·‖₁\nm/s", "in the 1-norm", row["craft_delta_v"]),
        ("Δv ‖·‖₂\nm/s", "in the 2-norm", row["craft_delta_v_2norm"]),
        ("Δv by\nthrusters", "by its thrusters", row["craft_delta_v_thrusters"]),
    ]
    columns = [column for column in columns if column[2]]
    if len(row["craft_delta_v"]) <= MOST_CRAFT:
        headings = ["craft", *(heading for heading, _, _ in columns)]
        cells = [list(map(number, of)) for _, _, of in columns]
        if row["craft_share"]:
            headings.append("of what\nit may")
            cells.append([f"{one:.1%}" for one in row["craft_share"]])
        print_table(headings, [[str(k), *of] for k, of in enumerate(zip(*cells, strict=True))])
        return
    spans = [f"{number(min(of))} to {number(max(of))} m/s {name}" for _, name, of in columns]
    echo(f"Δv of each craft: {', '.join(spans)}.")


def is_unsolved(row: Row) -> bool:
    """Whether a plan's status is other than solved, so that it must not be flown."""
    return row["status"] != "solved"


def _adrift(row: Row) -> list[str]:
    found = row["passive_safety"]
    if clear := found.get("clearance"):
        return [f"{clear['craft']}@{clear['node']}", f"{clear['min_clearance']:+.2f}"]
    if found["pair"] is None:
        return [MISSING] * 2
    return [f"{found['pair'][0]}@{found['node']}", f"{found['min_separation']:.2f}"]


def _saved(row: Row) -> list[str]:
    saving = row["assignment"]["saving"]
    return [MISSING if saving is None else f"{saving:z.1%}"]


def _risk(row: Row) -> list[str]:
    risk = row["risk"]
    bare, feedback = risk["fuel_without"], risk["feedback"]
    costs = f"{row['fuel'] / bare - 1:z.2%}" if bare else MISSING
    if bare and feedback:
        added = feedback["delta_v"] / row["delta_v"] * row["fuel"] / bare
        costs = f"{costs.removesuffix('%')}+{added:.1%}"
    return [number(risk["bound"]), costs]


def _share(row: Row) -> list[str]:
    share = row["largest_share"]
    return [f"{share['share']:.2%}", f"{share['bound']:.2%}"]


def _burn(row: Row) -> list[str]:
    burn = row["smallest_burn"]
    least, bare = burn["least"], burn["fuel_without"]
    return [
        MISSING if least is None else number(1e3 * least),
        f"{row['fuel'] / bare - 1:z.2%}" if bare and row["fuel"] else MISSING,
    ]


# Columns shown where a plan has the field of this name: their headings, and a row's cells
EXTRA = {
    "risk": (("risk\n≤", "safety\ncosts"), _risk),
    "passive_safety": (("adrift\nfrom", "apart\nm"), _adrift),
    "assignment": (("saved\n≥",), _saved),
    "largest_share": (("largest\nshare", "\n≥"), _share),
    "smallest_burn": (("least\nmm/s", "bit\ncosts"), _burn),
}


def _remarks(row: Row) -> list[str]:
    said = [f"{row['status']} by {row['planner']}: {row['message']}"] if is_unsolved(row) else []
    if row["assignment"] and row["assignment"]["given_fuel_lower_bound"] is None:
        inside = " inside its corridors" if row.get("corridor") else ""
        said.append(
            f"in the given order some craft cannot reach its goal{inside} within its limits, which "
            "is proven."
        )
    if row["model_error"] > row["collision_radius"]:
        said.append(
            f"outside the linear model craft end some {row['model_error']:.2g} m off their goals, "
            f"more than collision_radius: prolearn fly {as_argument(row['plan'])}"
        )
    return said
