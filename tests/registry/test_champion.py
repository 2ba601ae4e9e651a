"""Two versions on the same validation data: the safer one is better, then the cheaper one."""

from collections.abc import Callable
from pathlib import Path

import pytest
from noisy import network

from cli.jobs.train import challenge, flown_metrics, promote, train_model
from cli.jobs.training import validation_trials
from cli.settings import TrainingSettings
from pipeline.errors import InputError
from pipeline.networks.model import Model
from registry.models import ModelVersion, list_versions, resolve
from registry.store import connect

Register = Callable[..., tuple[ModelVersion, Model]]


def test_a_version_that_burns_less_on_the_same_validation_data_takes_the_champions_place(
    register: Register, solved: Path
) -> None:
    register(1.0)  # the first is champion
    cheap, model = register(0.0)
    held = challenge(cheap, validation_trials(model, solved, 3), solved)
    assert held.champion.version == 2
    assert resolve("ff1").version == 2
    assert held.reason.startswith("of 6 validation scenarios ")

    dear, model = register(2.0)
    held = challenge(dear, validation_trials(model, solved, 3), solved)
    assert held.champion.version == 2
    assert [v.aliases for v in list_versions()] == [(), ("champion",), ()]


def test_a_worse_version_becomes_champion_only_by_force(register: Register) -> None:
    register(0.0)
    register(1.0)
    with pytest.raises(
        InputError, match=r"safe with version 2 and .* with version 1, at .*--force"
    ):
        promote("ff1", 2)
    assert resolve("ff1").version == 1
    assert promote("prolearn-ff1", 2, force=True)[0].aliases == ("champion",)
    better, reason = promote("ff1", 1)  # which needs no force
    assert better.version == 1
    assert resolve("ff1").contest == reason != ""
    assert [v.aliases for v in list_versions()] == [("champion",), ()]


@pytest.mark.parametrize(
    ("safe", "said"),
    [
        ([True] * 5 + [False], "m/s²; fuel decides, since the difference in safety may be chance"),
        ([True] * 6, "m/s²; fuel decides"),
        ([False] * 6, "m/s²"),  # none of six: once in 32 by chance
    ],
)
def test_the_reason_says_whether_safety_decides_or_fuel(
    safe: list[bool], said: str, register: Register, solved: Path
) -> None:
    register(0.0)
    other, model = register(2.0)
    trials = validation_trials(model, solved, 3).assign(safe=safe)
    assert challenge(other, trials, solved).reason.endswith(said)


def test_versions_of_other_data_are_compared_on_one_that_is_given(
    register: Register, solved: Path
) -> None:
    register(1.0)
    register(0.0, data="gone/elsewhere")
    with pytest.raises(InputError, match=r"gone/elsewhere does not exist.*--data"):
        promote("ff1", 2)
    assert promote("ff1", 2, str(solved))[0].version == 2


def test_a_version_whose_training_run_was_deleted_is_compared_on_data_that_are_given(
    register: Register, solved: Path
) -> None:
    register(1.0)
    better, _ = register(0.0)
    connect().client.delete_run(better.run_id)
    with pytest.raises(InputError, match=r"the run that names what .* is gone.*give --data"):
        promote("ff1", 2)
    assert promote("ff1", 2, str(solved))[0].version == 2


def test_a_training_says_how_safe_and_dear_it_is_on_validation_data_and_who_is_champion(
    folder: Path, solved: Path
) -> None:
    how = TrainingSettings(data=str(solved), n=3, epochs=1, device="cpu")
    version, held = train_model("ff1", 0, how)
    assert held.champion.version == version.version == 1
    assert 0 <= version.metrics["valid_flown_safe_share"] <= 1
    assert version.metrics["valid_flown_fuel"] > 0
    assert (
        flown_metrics(validation_trials(network(0.0), solved, 3))["valid_flown_fuel"]
        < (flown_metrics(validation_trials(network(2.0), solved, 3))["valid_flown_fuel"])
    )
