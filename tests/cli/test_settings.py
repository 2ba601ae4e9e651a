"""Options of commands are the fields of frozen dataclasses."""

from dataclasses import dataclass, fields
from typing import Annotated

import pytest
import typer
from typer.testing import CliRunner

from cli.main import app
from cli.options import int_list, name_list, with_settings
from cli.settings import (
    Evaluation,
    FlightConditions,
    Flights,
    FlownTrials,
    RiskSettings,
    Tradeoff,
    TrainingSettings,
    TransferTimes,
    TuningSettings,
    WarmStarts,
)
from pipeline.errors import InputError
from pipeline.orbit.problem import Problem
from pipeline.scenario.families import SEEDS


@dataclass(frozen=True, kw_only=True)
class Orbit:
    altitude: Annotated[float, typer.Option(help="m.")]
    names: Annotated[list[str] | None, typer.Option("--name")] = None


@dataclass(frozen=True)
class Colour:
    dark: Annotated[bool, typer.Option("--dark")] = False


def test_a_command_gets_its_dataclasses_from_options_and_keeps_its_other_parameters():
    seen = []

    @with_settings
    def command(first: int, orbit: Orbit, colour: Colour, last: str = "z") -> None:
        """Take them."""
        seen.append((first, orbit, colour, last))

    one = typer.Typer()
    one.command()(command)
    done = CliRunner().invoke(one, ["7", "--altitude", "5e5", "--name", "a", "--name", "b"])
    assert done.exit_code == 0, done.output
    assert seen == [(7, Orbit(altitude=5e5, names=["a", "b"]), Colour(dark=False), "z")]
    assert CliRunner().invoke(one, ["7"]).exit_code == 2, "a field without a default is required"


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("evaluate", [Evaluation]),
        ("warmstart", [WarmStarts]),
        ("transfer-times", [TransferTimes]),
        ("flights", [Flights]),
        ("train", [TrainingSettings]),
        ("tune", [TuningSettings]),
        ("tradeoff", [Tradeoff]),
        ("fly", [FlightConditions, FlownTrials]),
    ],
)
def test_every_field_of_a_job_s_settings_is_an_option_with_the_same_default(name, settings):
    command = typer.main.get_command(app).commands[name]
    options = {option.name: option for option in command.params}
    for field in (field for one in settings for field in fields(one)):
        option = options[field.name]
        assert option.required or option.default == field.default


def test_an_error_of_0_is_one_that_is_given():
    """Velocities that are known exactly, not what goes with positions by default."""
    limit = RiskSettings(asked=0.1, navigation_sigma=0.2, velocity_sigma=0.0).limit()
    assert limit is not None
    assert limit.uncertainty(Problem()).velocity == 0


def test_names_and_numbers_of_a_list_count_once():
    assert name_list(" ff1,ff2, ff1,,") == ["ff1", "ff2"]
    assert int_list("3,1..3,2", "--seed", least=0) == [1, 2, 3]
    for text in ("2..", "5,2..", "5,9..7"):  # each would leave out what was meant
        with pytest.raises(InputError, match=r"from 1 to 4294967295, such as 10"):
            int_list(text)


def test_a_number_that_is_too_large_is_told_the_largest():
    with pytest.raises(InputError, match=r"--seed is '99999999999'; .* from 0 to 4294967295, such"):
        int_list("99999999999", "--seed", least=0)
    assert int_list(f"{SEEDS - 1}", "--seed", least=0) == [4294967295]
    with pytest.raises(InputError, match=r"from 0 to 4294967295, such"):
        int_list(f"{SEEDS}", "--seed", least=0)
