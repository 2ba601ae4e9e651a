"""Whoever writes to a shared store: what they write is text in report, cards, tables and JSON."""

import base64
import json
from collections.abc import Callable
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hostile import HOSTILE, READ, SEEN, assert_plain, read
from planted import one_size, planted
from short_transfer import PROBLEM
from typer.testing import CliRunner

from cli.main import app
from pipeline.experiments.example_transfer import write_example
from pipeline.figures.transfer import Example
from pipeline.scenario import draw
from pipeline.scenario.document import write_scenario
from pipeline.training.loop import Trained
from registry.results import record
from registry.store import EVALUATION, TRANSFER_TIMES, connect
from registry.training import DatasetInfo, record_training

# Such a name is longer than a figure is wide.
pytestmark = pytest.mark.filterwarnings("ignore:constrained_layout not applied:UserWarning")

OUTSIDE = "../../../outside"
"""A recipe that would lead figures out of their folder."""


@dataclass(frozen=True)
class Written:
    """What parameters, tags and tables of the store say; it asks for a file that is there."""

    text: str

    def of(self, shown: str) -> str:
        """How it is shown, from how HOSTILE is."""
        return shown.replace("![i](/etc/passwd)", self.text.partition(" ")[0])


@pytest.fixture(scope="module")
def secret(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("secret") / "secret.svg"
    path.write_text("what nobody else may read")
    return path


@pytest.fixture
def written(
    once: Callable[..., Written],
    folder: Path,
    secret: Path,
    trained: Trained,
    dataset: DatasetInfo,
) -> Written:
    """A store with a model, an evaluation and transfer times, by somebody who means no good."""
    text = HOSTILE.replace("/etc/passwd", str(secret))
    data = DatasetInfo(text, dataset.digest, 20, 5)
    return once(text, lambda: write(text, folder, trained, data))


def write(text: str, folder: Path, trained: Trained, data: DatasetInfo) -> Written:
    version = record_training(trained, data)
    same = {"dataset_digest": data.digest, "models": version.uri, "data": text}
    files = folder / "files"
    files.mkdir()
    write_example(example(text), files / "0.npz")
    runs = [
        version.run_id,
        record(EVALUATION, trials(text), params=same, files=files),
        record(TRANSFER_TIMES, times(text), params=same),
    ]
    client = connect().client
    for run in runs:
        for tag in ("git_commit", "platform", "cores"):
            client.set_tag(run, tag, text)
    client.set_model_version_tag(version.name, str(version.version), "recipe", text)
    return Written(text)


def trials(text: str) -> pd.DataFrame:
    """Of known planners, and of one with a name and a recipe that are no text."""
    rows = pd.DataFrame([*one_size(10), *one_size(30)])
    rows = rows[rows["planner"].isin(["expert", "ff1", "my net"])]
    return rows.replace({"planner": {"my net": text}, "recipe": {"tuned": text}})


def times(text: str) -> pd.DataFrame:
    rows = [
        row | {"varied": varied, "nodes": nodes, "time_step": step}
        for varied, nodes, step in (("nodes", 6, 120.0), ("time_step", 11, 60.0))
        for planner, recipe in (("expert", ""), (text, OUTSIDE))
        for row in planted(planner, recipe, "flown", 10, [0, 0], [1.0, 1.1], [True, True])
    ]
    return pd.DataFrame(rows)


def example(text: str) -> Example:
    end = np.array([[100.0, 0, 0, 0, -0.2, 0], [-100.0, 0, 0, 0, 0.2, 0]])
    track = np.linspace(end[:, :3], end[::-1, :3], 9, axis=1)
    return Example(text, end, end[::-1].copy(), {"expert": track}, 15.0)


def run(*arguments: Any, status: int = 0) -> str:
    """What a command prints, in a wide window."""
    done = CliRunner().invoke(app, [str(one) for one in arguments], env={"COLUMNS": "5000"})
    assert done.exit_code == status, done.output
    return done.output


class Page(HTMLParser):
    """The tags of a page, where its images are from, and its text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags, self.images, self.text = set[str](), list[str](), ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.images += [str(value) for name, value in attrs if name == "src"]
        assert all(name in {"src", "alt"} for name, _ in attrs if tag == "img")

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.mark.drawn
def test_a_report_has_the_text_as_it_is_a_line_for_each_row_and_no_file_but_its_figures(
    written: Written, folder: Path, tmp_path: Path
) -> None:
    assert_plain(run("report", "--out", "reports"))
    out = folder / "reports"
    page = Page((out / "report.html").read_text(encoding="utf-8"))
    figures = [base64.b64encode(path.read_bytes()).decode() for path in out.rglob("*.svg")]
    inlined = [image.removeprefix("data:image/svg+xml;base64,") for image in page.images]
    assert sorted(inlined) == sorted(figures) and len(figures) > 5
    assert {"script", "iframe", "link", "s", "del"}.isdisjoint(page.tags)
    markdown = (out / "report.md").read_text(encoding="utf-8")
    for text in (page.text, read_with_figures(markdown)):
        assert text.count(written.of(READ)) > 5
        assert_plain(text)
    names = [path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*outside*")]
    assert names and all(name.startswith("my project/reports/figures/") for name in names)
    text = (out / "tables/provenance.csv").read_bytes().decode()
    assert_plain(text)
    table = pd.read_csv(out / "tables/provenance.csv")
    assert len(text.splitlines()) == len(table) + 1
    assert (table["data"] == written.of(SEEN)).all()


def read_with_figures(markdown: str) -> str:
    """What is read of a report beside its figures, each at the beginning of a line."""
    lines = markdown.splitlines()
    return read("\n".join(line for line in lines if not line.startswith("![Figure ")))


def test_lists_of_models_show_the_text(written: Written) -> None:
    listed, shown = run("models", "list"), run("models", "show", "ff1")
    assert_plain(listed, shown)
    assert written.of(SEEN) in listed
    assert shown.count(written.of(SEEN)) >= 4


def test_json_has_the_text_and_nothing_that_a_terminal_obeys(written: Written) -> None:
    printed = run("models", "show", "ff1", "--json")
    assert_plain(printed)
    told = json.loads(printed)
    assert told["params"]["dataset"] == told["recipe"] == told["tags"]["platform"] == written.text


def test_a_plan_by_such_a_model_is_shown_in_text(written: Written, folder: Path) -> None:
    write_scenario(folder / "s.json", draw("rings", 0, 3, 0, PROBLEM))
    asked = ["plan", "s.json", "--planner", "prolearn-ff1/1", "--raw", "--out", "p.json"]
    planned = CliRunner().invoke(app, asked).output  # safe or not
    for printed in (planned, run("show", "p.json")):
        assert_plain(printed)
        assert "ff1/1" in printed
    page = Page((folder / "p.html").read_text(encoding="utf-8"))
    assert "ff1/1" in page.text and "img" not in page.tags


@pytest.mark.usefixtures("known_operators")
def test_a_model_card_has_the_text(written: Written, folder: Path) -> None:
    assert_plain(run("models", "export", "ff1", "--out", "x.onnx"))
    card = (folder / "x.onnx.md").read_text(encoding="utf-8")
    assert_plain(card)
    assert read(card).count(written.of(READ)) >= 3
