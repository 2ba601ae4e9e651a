"""The card against other readers: PyYAML, the ``datasets`` library, pyarrow and numpy."""

import re
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as pads
import pyarrow.parquet as pq
import pytest
import yaml
from contents import content
from typer.testing import CliRunner

from cli.main import app
from pipeline.dataset import card
from pipeline.dataset.card import (
    HUB_NAMES,
    File,
    altitude_of,
    commands,
    files_by_split,
    preset_of,
    ranges,
    write_card,
)
from pipeline.dataset.making import sample, solve
from pipeline.dataset.manifest import read_manifest
from pipeline.dataset.samples import PRESETS, Sample
from pipeline.dataset.verifying import repair, verify
from pipeline.errors import InputError
from pipeline.expert import Settings
from pipeline.orbit.problem import Problem
from pipeline.orbit.reference import mean_motion_at
from pipeline.orbit.reference_orbit import ReferenceOrbit
from pipeline.parallel.workers import Workers
from pipeline.plan.requirements import Requirements

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs/dataset.md").read_text(encoding="utf-8")
ONE = Workers(jobs=1)

FILES = {
    "default": {"train_validation": ["n=2/*.parquet", "n=3/*.parquet"]},
    "n2": {
        "train": ["n=2/part-00000.parquet", "n=2/part-00001.parquet"],
        "validation": ["n=2/part-00002.parquet"],
    },
    "n3": {"train_validation": ["n=3/*.parquet"]},
}
"""Of ``solved``, by hand: six rows of n=2 for training and one for validation in shards of three,
five and one of n=3."""


@pytest.fixture(scope="session")
def hub(tmp_path_factory):
    """The ``datasets`` library, which goes to no network and leaves nothing behind."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HF_HUB_OFFLINE", "1")
        import datasets

        cache = tmp_path_factory.mktemp("hub")
        patch.setattr(datasets.config, "HF_DATASETS_CACHE", cache)
        yield datasets


@pytest.fixture
def carded(solved):
    write_card(solved)
    return solved


def head(folder):
    """The front matter."""
    _, front, _ = (folder / "README.md").read_text(encoding="utf-8").split("---\n", 2)
    return yaml.safe_load(front)


def body(folder):
    return (folder / "README.md").read_text(encoding="utf-8").split("---\n", 2)[2]


def rows_of(folder, paths):
    """What pyarrow reads."""
    found = [one for path in paths for one in sorted(folder.glob(path))]
    return pa.concat_tables([pq.read_table(one, partitioning=None) for one in found])


def cells(text, heading):
    """The rows of the table whose first column has a heading."""
    lines = text.splitlines()
    first = next(k for k, line in enumerate(lines) if re.match(rf"\| {heading} +\|", line))
    rows = []
    for line in lines[first + 2 :]:
        if not line.startswith("|"):
            break
        rows.append([cell.strip() for cell in line.strip("|").split("|")])
    return rows


def test_a_blank_line_stands_before_each_table_which_other_readers_of_markdown_need(carded):
    lines = body(carded).splitlines()
    tables = [k for k, line in enumerate(lines) if re.match(r"\|[ :|-]+\|$", line)]
    assert len(tables) >= 3
    assert [lines[k - 2] for k in tables] == [""] * len(tables)


@pytest.mark.parametrize("name", FILES)
def test_load_dataset_reads_the_rows_that_pyarrow_reads_split_by_split(name, carded, hub):
    loaded = hub.load_dataset(str(carded), name)
    assert set(loaded) == set(FILES[name])
    for split, paths in FILES[name].items():
        wanted = rows_of(carded, paths)
        assert loaded[split].to_list() == wanted.to_pylist()
        ours = {split.replace("validation", "valid") for split in split.split("_")}
        assert set(wanted["split"].to_pylist()) == ours


def test_columns_and_sizes_at_the_head_are_what_the_library_finds_in_the_files(carded, hub):
    (said,) = head(carded)["dataset_info"]
    schema = pq.read_schema(carded / "n=2/part-00000.parquet").remove_metadata()
    assert hub.Features._from_yaml_list(said["features"]) == hub.Features.from_arrow_schema(schema)
    every = sorted(str(one) for one in carded.glob("n=*/*.parquet"))
    found = hub.load_dataset("parquet", data_files={"train_validation": every})["train_validation"]
    (split,) = said["splits"]
    assert split == {
        "name": "train_validation",
        "num_bytes": found.info.splits["train_validation"].num_bytes,
        "num_examples": 13,
    }
    assert said["dataset_size"] == found.info.dataset_size
    assert said["download_size"] == sum(Path(one).stat().st_size for one in every)


def test_a_hub_reads_licence_name_and_size(solved):
    from huggingface_hub import DatasetCard

    write_card(solved, licence="cc-by-4.0")
    found = DatasetCard.load(solved / "README.md").data
    assert found.license == "cc-by-4.0"
    assert found.pretty_name == "Certified transfers of spacecraft swarms, n = 2 to 3"
    assert found.size_categories == ["n<1K"]
    assert found.to_dict() == head(solved)


def test_the_gaps_in_the_card_are_those_of_the_rows(carded):
    for n, row in zip((2, 3), cells(body(carded).partition("How good")[2], "n"), strict=True):
        table = rows_of(carded, [f"n={n}/*.parquet"])
        gaps = np.quantile(table["optimality_gap"].to_numpy(), [0.5, 0.9, 0.99, 1.0])
        separation = pc.min(table["min_separation"]).as_py()
        assert row[:6] == [
            str(n),
            f"{len(table)} of {len(table)}",
            *(f"{100 * gap:.3f} %" for gap in gaps),
        ]
        assert float(row[6]) == pytest.approx(np.mean(table["fuel"]), rel=1e-3)
        assert float(row[7]) == pytest.approx(separation, abs=1e-3)


def test_numbers_of_four_digits_end_in_no_point():
    assert [card._number(value, "{:#.4g}") for value in (0.5, 1234.4)] == ["0.5000", "1234"]


def test_scenarios_without_a_plan_are_counted_and_cost_the_others_nothing(tmp_path):
    folder = tmp_path / "limited"
    sample(folder, {10: Sample(count=6)}, Problem(max_acceleration=7e-4), workers=ONE)
    solve(folder, Settings(), workers=ONE)
    write_card(folder)
    status = pq.read_table(folder / "n=10/part-00000.parquet", columns=["status"])["status"]
    counts = {one["values"]: one["counts"] for one in pc.value_counts(status).to_pylist()}
    assert 0 < counts["solved"] < 6
    (said,) = re.findall(r"Of 6 scenarios: (.*?)\.", body(folder))
    assert dict(reversed(part.split(" ")) for part in said.split(", ")) == {
        name: str(count) for name, count in counts.items()
    }
    assert f"{counts['solved']} of 6" in cells(body(folder).partition("How good")[2], "n")[0]
    assert "thrust limit 0.0007 m/s² on each component" in body(folder)


def test_the_card_describes_every_column_as_the_documentation_does(carded):
    schema = pq.read_schema(carded / "n=2/part-00000.parquet")
    said = cells(body(carded), "column")
    assert [row[0].strip("`") for row in said] == schema.names
    assert said == cells(PAGE, "column")
    for name, told, unit, _ in said:
        kind = schema.field(name.strip("`")).type
        listed = "doubles" in told
        assert pa.types.is_list(kind) == listed
        assert listed or told == str(kind)
        assert not unit or listed or pa.types.is_float64(kind)


CIRCLE = Problem(mean_motion_at(612_345.6), 90.0, 9, 12.5, 0.02)
ECCENTRIC = CIRCLE.about(ReferenceOrbit(8.1e6 / 3 * 3.1, 0.123, 51.6, raan_deg=1 / 3))


@pytest.mark.parametrize("problem", [CIRCLE, ECCENTRIC], ids=["a circle", "e 0.123"])
def test_the_commands_in_the_card_make_the_same_bytes(tmp_path, monkeypatch, problem):
    monkeypatch.chdir(tmp_path)
    one = Sample(family="tilt-split", seed=7, count=4, shares=(0.5, 0.25, 0.25), shard_rows=3)
    sample(
        "data/first", {2: one, 5: replace(one, count=2, seed=8)}, problem, workers=Workers(jobs=1)
    )
    solve("data/first", Settings(), Requirements("nodes"), workers=ONE)
    write_card("data/first")
    block = body(tmp_path / "data/first").partition("```\nprolearn")[2].partition("```")[0]
    for line in f"prolearn{block}".strip().splitlines():
        done = CliRunner().invoke(app, shlex.split(line)[1:])
        assert done.exit_code == 0, done.output
    first, again = (content(tmp_path / "data" / name) for name in ("first", "again"))
    shards = [name for name in first if name.startswith("n=")]
    assert len(shards) == 3
    assert [again[name] for name in shards] == [first[name] for name in shards]


def test_settings_that_no_option_sets_are_named_beside_the_commands(carded, tmp_path):
    assert "No option sets" not in body(carded)
    folder = tmp_path / "safe"
    sample(folder, {2: Sample(count=2)}, Problem(), workers=ONE)
    solve(folder, Settings(margin=0.1), Requirements(passive_safety=0.5), workers=ONE)
    write_card(folder)
    assert "No option sets `margin`, `passive_safety`: in place of the last" in body(folder)


def test_a_preset_is_named_even_where_sizes_are_missing(solved):
    manifest = replace(read_manifest(solved), samples=PRESETS["demo"])
    assert list(commands(manifest, "x")) == ["prolearn dataset --preset demo --out x"]
    early = {n: one for n, one in PRESETS["paper"].items() if n <= 30}
    older = {name: value for name, value in manifest.solve.items() if name != "beside"}
    assert preset_of(replace(manifest, samples=early, solve=older)) == "paper"
    assert preset_of(replace(manifest, samples={2: Sample(count=99)})) is None
    nodes = {**manifest.solve, "separation": "nodes"}
    assert preset_of(replace(manifest, solve=nodes)) is None


@pytest.mark.parametrize("altitude", [500e3, 412_345.6, 35_786_000.0, 250_000.125])
def test_an_altitude_comes_back_as_it_was_typed(altitude):
    assert altitude_of(mean_motion_at(altitude)) == altitude


def test_ranges_of_sizes_are_told_in_words():
    assert ranges([2, 3, 4, 10, 60, 61]) == "2 to 4, 10, 60 to 61"


@pytest.mark.parametrize(
    "one",
    [
        Sample(count=1000),
        Sample(count=10_000),
        Sample(count=7, shard_rows=3),
        Sample(count=100, shares=(0.0, 0.0, 1.0)),
        *(PRESETS[name][10] for name in PRESETS),
    ],
    ids=lambda one: f"{one.count} in {one.shard_rows}",
)
def test_a_split_is_there_whole_or_not_by_itself(solved, one):
    about = replace(read_manifest(solved), samples={4: one}, shards={})
    files = [File(shard, len(shard.rows), 0, 0) for shard in about.expected()]
    found = files_by_split(files)
    assert sorted(f.shard.number for some in found.values() for f in some) == [
        *range(len(files))
    ], "each file once"
    for name, some in found.items():
        held = {split for file in some for split, _ in one.drawn_as(file.shard.rows)}
        assert name.split("_") == [HUB_NAMES[s] for s in HUB_NAMES if s in held]
        rows = sum(len(one.splits[split]) for split in held)
        assert rows == sum(file.rows for file in some)


def test_the_card_and_what_keeps_the_folder_are_no_foreign_files(carded):
    for name in (".gitattributes", ".git/objects/ab/cd"):
        (carded / name).parent.mkdir(parents=True, exist_ok=True)
        (carded / name).write_text("of git")
    (carded / "n=2/README.md").write_text("a card where none belongs")
    before = content(carded)
    assert [fault.path for fault in verify(carded, workers=ONE)] == ["n=2/README.md"]
    solve(carded, Settings(), workers=ONE)
    assert content(carded) == before
    assert [fault.path for fault in repair(carded, workers=ONE)] == ["n=2/README.md"]
    assert content(carded) == {k: v for k, v in before.items() if k != "n=2/README.md"}
    assert (carded / "_foreign/n=2/README.md.1").read_text() == "a card where none belongs"


def test_the_documented_way_to_read_a_whole_folder_with_a_card(carded):
    assert "`exclude_invalid_files=True`" in PAGE
    found = pads.dataset(carded, format="parquet", exclude_invalid_files=True)
    assert found.count_rows() == 13


def test_a_lost_shard_comes_back_beside_a_card(carded):
    before = content(carded)
    (carded / "n=2/part-00001.parquet").unlink()
    repair(carded, workers=ONE)
    assert content(carded) == before


def test_a_readme_that_a_person_wrote_is_replaced_only_when_asked_for(solved):
    (solved / "README.md").write_text("mine")
    with pytest.raises(InputError, match=r"README\.md that says something else.*--force"):
        write_card(solved)
    assert (solved / "README.md").read_text() == "mine"
    text = write_card(solved, replace=True)
    assert (solved / "README.md").read_text(encoding="utf-8") == text
    assert write_card(solved) == text, "its own card is no obstacle"


def test_a_dataset_that_is_not_solved_or_damaged_gets_no_card(solved, tmp_path):
    sample(tmp_path / "fresh", {2: Sample(count=3)}, Problem(), workers=ONE)
    with pytest.raises(InputError, match="prolearn solve"):
        write_card(tmp_path / "fresh")
    shard = solved / "n=2/part-00001.parquet"
    shard.write_bytes((solved / "n=2/part-00000.parquet").read_bytes())
    with pytest.raises(InputError, match=r"part-00001.*--repair"):
        write_card(solved)
    with pytest.raises(InputError, match="licence is 'My own!'"):
        write_card(solved, licence="My own!")
    assert not (solved / "README.md").exists()


def test_a_dataset_without_a_plan_has_a_card_that_says_so(tmp_path):
    weak = replace(Problem(), max_acceleration=1e-9)
    sample(tmp_path, {2: Sample(count=1, shares=(1.0, 0.0, 0.0))}, weak, workers=ONE)
    solve(tmp_path, Settings(), workers=ONE)
    assert "all other craft, so the true difference may be much smaller. No row is solved." in (
        " ".join(write_card(tmp_path).split())
    )


def test_the_card_is_the_same_for_any_number_of_workers_and_pieces(carded, monkeypatch):
    alone = (carded / "README.md").read_bytes()
    monkeypatch.setattr(card, "VALUES_PER_TASK", 1)  # each shard by itself
    monkeypatch.setattr(card, "FEW_TASKS", 0)
    for jobs in (1, 2):
        (carded / "README.md").unlink()
        write_card(carded, workers=Workers(jobs))
        assert (carded / "README.md").read_bytes() == alone


def test_the_citation_is_that_of_the_project(carded):
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())["preferred-citation"]
    said = dict(re.findall(r"^  (\w+) += \{(.*)\}", body(carded), re.MULTILINE))
    names = [f"{one['family-names']}, {one['given-names']}" for one in cited["authors"]]
    assert said == {
        "author": " and ".join(names),
        "title": cited["title"],
        "booktitle": cited["collection-title"],
        "year": str(cited["year"]),
    }


def test_the_snippets_in_the_card_run_in_the_folder_above(carded, hub, monkeypatch):
    monkeypatch.chdir(carded.parent)
    wanted = rows_of(carded, ["n=*/*.parquet"])
    first, second = re.findall(r"```python\n(.*?)```", body(carded), re.DOTALL)
    names = {}
    exec(first, names)
    assert names["rows"]["train_validation"].to_list() == wanted.to_pylist()
    exec(second, names)
    assert names["rows"]["scenario_id"].tolist() == wanted["scenario_id"].to_pylist()


def test_the_documented_snippets_read_what_pyarrow_reads(tmp_path, hub, monkeypatch):
    monkeypatch.chdir(tmp_path)
    one = Sample(count=24, shares=(0.5, 0.0, 0.5), shard_rows=12)
    sample("data/n10", {10: one}, Problem(max_acceleration=7e-4), workers=ONE)
    solve("data/n10", Settings(), workers=ONE)
    write_card("data/n10")
    rows = rows_of(tmp_path / "data/n10", ["n=10/*.parquet"]).to_pylist()
    solved = [row for row in rows if row["status"] == "solved"]
    train = [row["states"] for row in solved if row["split"] == "train"]
    gaps = [row["optimality_gap"] for row in solved if row["split"] == "test"]
    assert train and gaps and len(solved) < 24
    hub_s, pandas_s, duckdb_s = re.findall(
        r"```python\n(.*?)```", PAGE.partition("## A card")[2].partition("## Presets")[0], re.DOTALL
    )
    names = {}
    exec(hub_s, names)
    assert np.array_equal(names["states"], np.reshape(train, (-1, 10, 11, 6)))
    exec(pandas_s, names)
    assert names["gaps"].to_list() == pytest.approx(np.quantile(gaps, [0.5, 0.9, 0.99]))
    exec(duckdb_s, names)
    (row,) = names["gaps"].to_dict("records")
    every = [row["optimality_gap"] for row in solved]
    assert row == {
        "n_spacecraft": 10,
        "solved": len(solved),
        "gap": pytest.approx(np.median(every)),
    }
