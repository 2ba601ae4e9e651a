"""README.md of a dataset: what it is, how it was made, what it holds and how good it is."""

import json
import re
from collections.abc import Mapping
from typing import Any

import pandas as pd

from pipeline.dataset.card.contents import QUANTILES, Contents, gap_name, quality, read_contents
from pipeline.dataset.card.front_matter import front_matter
from pipeline.dataset.card.origin import (
    altitude_of,
    commands,
    described,
    drawn_alike,
    preset_of,
    ranges,
)
from pipeline.dataset.card.splits import files_by_split
from pipeline.dataset.format.columns import COLUMNS
from pipeline.dataset.format.layout import CARD
from pipeline.dataset.format.manifest import Manifest
from pipeline.dataset.format.solving import requirements_of
from pipeline.dataset.stages.presets import PRESETS
from pipeline.errors import InputError
from pipeline.markdown import Markdown, code, formatted, table, verbatim
from pipeline.plan import SOLVED
from pipeline.progress import SILENT, Progress
from pipeline.scenario import SPLITS
from pipeline.storage.folder import Folder, Where, open_folder
from pipeline.templates import template

LICENCE = "mit"
"""Of data that come with prolearn: the project's own."""

IDENTIFIER = re.compile(r"[a-z0-9][a-z0-9.-]*")
"""How hubs write the name of a licence."""

AGAIN = "data/again"
"""Folder in the commands that make a dataset once more."""


def write_card(
    where: Where | Folder,
    *,
    licence: str = LICENCE,
    replace: bool = False,
    progress: Progress = SILENT,
) -> str:
    """Write the card of a solved dataset into its folder.

    Args:
        where: the dataset.
        licence: of the data, by its identifier, such as "mit" or "cc-by-4.0".
        replace: also where there is a README.md that says something else.
        progress: told how far it is.

    Returns:
        The card, Markdown with front matter.

    Raises:
        InputError: where the folder holds no dataset, it is not wholly solved, a shard is damaged,
            there is another README.md, or the licence is no identifier.
        ProlearnError: where the folder cannot be written to.
    """
    if not IDENTIFIER.fullmatch(licence):
        raise InputError(
            f"licence is {licence!r}; expected an identifier such as mit or cc-by-4.0."
        )
    folder = open_folder(where)
    text = card_of(read_contents(folder, progress), _name(folder), licence)
    there = folder.read(CARD) if folder.exists(CARD) else None
    if there == text.encode():
        return text
    if there is not None and not replace:
        raise InputError(
            f"{folder} has a {CARD} that says something else; move what you wrote there out of "
            "the way, or replace it with --force."
        )
    folder.publish(CARD, text.encode())
    return text


def card_of(contents: Contents, name: str, licence: str) -> str:
    """The card of a dataset whose folder has a name."""
    manifest = contents.manifest
    splits, quoted = files_by_split(contents.files), json.dumps(name, ensure_ascii=False)
    title = f"Certified transfers of spacecraft swarms, n = {ranges(sorted(manifest.samples))}"
    body = template("pipeline/dataset/card/card.md.jinja").render(
        title=title,
        quoted=verbatim(quoted),
        one_size=f'load_dataset({quoted}, "n{min(manifest.samples)}")',
        licence=licence,
        problem=manifest.problem,
        altitude=altitude_of(manifest.problem.mean_motion) / 1e3,
        at_nodes=requirements_of(manifest.solve).at_nodes,
        sizes=sorted(manifest.samples),
        mebibytes=sum(file.stored for file in contents.files) / 2**20,
        joined=Markdown(", ".join(code(name) for name in splits if "_" in name)),
        solved=SOLVED,
        columns=_columns(),
        **_origin(manifest),
        **_worth(contents.rows),
    )
    return f"---\n{front_matter(contents, title, licence)}---\n\n{body}"


def _name(folder: Folder) -> str:
    """The last part of where it is."""
    if folder.local:
        return folder.local.resolve().name
    return str(folder).rstrip("/").rpartition("/")[2]


def _columns() -> Markdown:
    rows = [(code(one.name), one.type, one.unit, Markdown(one.meaning)) for one in COLUMNS]
    return table(("column", "type", "unit", "meaning"), rows)


def _origin(manifest: Manifest) -> Mapping[str, Any]:
    """What the template says about how it was made."""
    made, preset = manifest.made_with, preset_of(manifest)
    draws = [
        (ranges(sizes), way.family, way.seed, way.count, *map(len, way.splits.values()))
        for sizes, way in drawn_alike(manifest)
    ]
    names = sorted({*made.sample, *made.solve})
    versions = [(name, made.sample.get(name, ""), made.solve.get(name, "")) for name in names]
    settings = (formatted("{} {}", code(name), value) for name, value in manifest.solve.items())
    families = sorted({way.family for way in manifest.samples.values()})
    return {
        "draws": table(("n", "family", "seed", "scenarios of each n", *SPLITS), draws),
        "families": {name: described(name) for name in families},
        "commands": list(commands(manifest, AGAIN)),
        "missing": ranges(sorted({*PRESETS.get(preset or "", {})} - {*manifest.samples})),
        "versions": table(("", "scenarios", "plans"), versions),
        "settings": Markdown(", ".join(settings)),
        "digest": manifest.digest(),
    }


def _worth(rows: pd.DataFrame) -> Mapping[str, Any]:
    """What the template says about how good the plans are."""
    gaps = rows.loc[rows["status"] == SOLVED, "optimality_gap"].quantile(list(QUANTILES))
    numbers = [
        (
            str(n),
            f"{row['solved']:.0f} of {row['rows']:.0f}",
            *(_percent(row[gap_name(q)]) for q in QUANTILES),
            _number(row["fuel"], "{:#.4g}"),
            _number(row["min_separation"], "{:.3f}"),
        )
        for n, row in quality(rows).iterrows()
    ]
    head = ("n", "solved", "gap, median", "90 %", "99 %", "largest")
    return {
        "scenarios": len(rows),
        "statuses": ", ".join(f"{k} {name}" for name, k in rows["status"].value_counts().items()),
        "gaps": {q: _percent(gap) for q, gap in gaps.items()},
        "quality": table((*head, "fuel, mean (m/s²)", "least separation (m)"), numbers),
    }


def _percent(share: float) -> str:
    return _number(100 * share, "{:.3f} %")


def _number(value: float, form: str) -> str:
    """A number, or nothing where there is none."""
    return "" if pd.isna(value) else form.format(value)
