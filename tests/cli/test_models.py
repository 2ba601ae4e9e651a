from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from typer.testing import CliRunner

from cli.main import app
from registry import models
from registry.models import ModelVersion

VERSION = ModelVersion(
    name="prolearn-lstmcol",
    version=12,
    arch="lstmcol",
    recipe="tuned",
    run_id="r",
    model_id="m-1",
    aliases=("champion",),
    dataset_digest="0123456789abcdef",
    created=datetime.now(UTC) - timedelta(days=3, hours=5),
    params={"dataset": "data/paper"},
    metrics={
        "valid_position_rmse": 12.345,
        "exp1_flown_collisions": 0.4567,
        "exp1_flown_fuel": 0.08123,
    },
    tags={},
)


def test_a_version_is_printed_without_what_its_run_holds() -> None:
    said = repr(VERSION)
    assert "name='prolearn-lstmcol', version=12" in said
    assert len(said) < 400 and "valid_position_rmse" not in said


def listed(monkeypatch: pytest.MonkeyPatch, *versions: ModelVersion) -> list[str]:
    monkeypatch.setattr(models, "list_versions", lambda: list(versions))
    done = CliRunner().invoke(app, ["models", "list"], env={"COLUMNS": "80"})
    assert done.exit_code == 0
    return done.output.splitlines()


def test_the_list_has_everything_of_a_version_on_one_line_of_80_columns(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lines = listed(monkeypatch, VERSION)
    assert max(len(line) for line in lines) <= 80
    wanted = "prolearn-lstmcol 12 champion tuned 12.3 0.457 0.0812 paper 012345 3 d"
    assert lines[-1].split() == wanted.split()


def test_a_version_that_was_never_evaluated_is_listed_without_numbers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bare = replace(VERSION, aliases=(), metrics={}, created=datetime.now(UTC))
    line = listed(monkeypatch, bare)[-1]
    assert line.split() == ["prolearn-lstmcol", "12", "tuned", "paper", "012345", "new"]


@pytest.mark.parametrize("terminal", [False, True])
def test_one_version_is_shown_to_the_last_character(
    terminal: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Long values wrap on a terminal and stay on one line in a pipe or file."""
    digest = "0123456789abcdef" * 16
    long = replace(VERSION, params={"dataset_digest": digest})
    monkeypatch.setattr(models, "resolve", lambda _: long)
    given = {"COLUMNS": "80", **({"FORCE_COLOR": "1", "TERM": "dumb"} if terminal else {})}
    done = CliRunner().invoke(app, ["models", "show", "lstmcol"], env=given)
    assert done.exit_code == 0
    assert (digest in done.output) is not terminal
    assert digest in "".join(done.output.split())
