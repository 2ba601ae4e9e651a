"""How a refiner is exported, with files that another test makes: tracing them takes a while."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from hostile import HOSTILE, READ, assert_plain, read
from typer.testing import CliRunner

from cli.main import app
from pipeline.networks.architecture import find
from pipeline.networks.model import Model
from pipeline.networks.refiner.model import packaged
from pipeline.networks.refiner.on_board import STEPS, outputs, told_each_round
from pipeline.networks.refiner.on_board_export import ExportedCraft
from pipeline.training.loop import Trained
from registry.models import resolve
from registry.store import connect
from registry.training import DatasetInfo


@pytest.fixture
def exported(monkeypatch: pytest.MonkeyPatch) -> list[Model]:
    """The models whose files were asked for; none is traced."""
    asked = []

    def export_craft(model: Model, path: Path, about: object) -> ExportedCraft:
        asked.append(model)
        ones = dict.fromkeys(STEPS, 1e-3)
        told, digests = told_each_round(model.config["message"]), dict.fromkeys(STEPS, "0" * 64)
        checked = {"swarms": 6, "ties": 1, "encounters": 29, "difference": 2e-7, "seconds": ones}
        return ExportedCraft(path, ones, digests, told, **checked)

    monkeypatch.setattr("cli.jobs.export.export_craft", export_craft)
    return asked


@pytest.fixture
def refiner(
    folder: Path,
    recorded: Callable[..., object],
    trained: Trained,
    dataset: DatasetInfo,
    exported: list[Model],
) -> Path:
    """The current folder, with a registered refiner whose files need no tracing."""
    architecture = find("refiner")
    torch.manual_seed(0)
    network = architecture.network(architecture.config, trained.model.encoding, 0.0)
    given = (architecture.config, "tuned", trained.model.encoding, network)
    recorded(replace(trained, model=Model("refiner", *given)), dataset)
    return folder


def test_the_packaged_refiner_is_exported_without_a_store(
    fresh: Path, exported: list[Model]
) -> None:
    """That its files plan as it does, the tests of these files hold."""
    done = CliRunner().invoke(app, ["models", "export", "packaged"])
    assert done.exit_code == 0, done.output
    assert "prolearn-refiner-packaged/: one craft's steps" in done.output
    (model,) = exported
    assert model.digest == packaged().digest
    assert not (fresh / "mlflow.db").exists()
    card = (fresh / "prolearn-refiner-packaged.md").read_text(encoding="utf-8")
    assert "The refiner that comes with prolearn: one craft" in card and "Registered" not in card
    done = CliRunner().invoke(app, ["models", "export", "packaged", "--n", "3"])
    assert done.exit_code == 2 and "is given for packaged; expected neither" in done.output


def test_an_option_that_one_of_several_models_does_not_take_stops_all(
    folder: Path, recorded: Callable[..., object], trained: Trained, dataset: DatasetInfo
) -> None:
    arch = trained.model.architecture
    recorded(trained, dataset)
    done = CliRunner().invoke(app, ["models", "export", arch, "packaged", "--n", "3"])
    assert done.exit_code == 2 and "is given for packaged; expected neither" in done.output
    assert not [*folder.glob("*.onnx*")]


def test_a_refiner_becomes_a_folder_with_a_card_that_names_every_input_and_output(
    refiner: Path,
) -> None:
    done = CliRunner().invoke(app, ["models", "export", "refiner"])
    assert done.exit_code == 0, done.output
    assert "prolearn-refiner-v1/: one craft's steps: begin" in done.output
    assert "for each live encounter: 50 numbers" in done.output
    card = (refiner / "prolearn-refiner-v1.md").read_text(encoding="utf-8")
    for name, step in STEPS.items():
        part = card.split(f"\n## {name}\n")[1].split("\n## ")[0]
        rows = [line.split("|")[1:3] for line in part.splitlines() if line.startswith("|")]
        named = [(way.strip(), one.strip().strip("`")) for way, one in rows[2:]]
        wanted = [("input", one) for one in step.takes]
        assert named == wanted + [("output", one) for one in outputs(step)]
    for words in ("50 numbers", "x y z (m), vx vy vz (m/s)", "(P, 2, 6)", "another optimum"):
        assert words in card


@pytest.mark.parametrize("option", [("--n", "3"), ("--flown",)])
def test_a_refiner_is_of_one_craft_and_always_flown(refiner: Path, option: tuple[str]) -> None:
    done = CliRunner().invoke(app, ["models", "export", "refiner", *option])
    assert done.exit_code == 2
    assert "expected neither" in done.output
    assert list(refiner.glob("prolearn-refiner*")) == []


def test_the_card_of_one_craft_has_what_the_store_says_as_text(refiner: Path) -> None:
    client, version = connect().client, resolve("prolearn-refiner/1")
    client.set_tag(version.run_id, "git_commit", HOSTILE)
    client.set_model_version_tag(version.name, "1", "recipe", HOSTILE)
    client.set_model_version_tag(version.name, "1", "dataset_digest", HOSTILE)
    done = CliRunner().invoke(app, ["models", "export", "prolearn-refiner/1"])
    assert done.exit_code == 0, done.output
    card = (refiner / "prolearn-refiner-v1.md").read_text(encoding="utf-8")
    assert_plain(card)
    assert read(card).count(READ) == 3
