"""A training, and an epoch of it, as rows of the tables that the report is made from."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Training:
    """A trained model; None is what its run does not say.

    Attributes:
        arch: architecture.
        recipe: how it was trained.
        training_seed: of weights, order and dropout.
        version: of the registered model.
        parameters: weights.
        epochs: that the training took.
        train_instances: that it learnt from.
        best_epoch: whose weights were kept.
        valid_loss: at the best epoch.
        valid_flown_safe_share: share of validation scenarios in which it is safe when flown.
        valid_flown_fuel: average there, m/s².
        valid_flown_trials: validation scenarios that were flown.
        seconds: of training.
        device: that it was trained on.
        threads: likewise.
        weights_kib: size of the weights, KiB.
    """

    arch: str
    recipe: str
    training_seed: int
    version: int
    parameters: int | None
    epochs: int | None
    train_instances: int | None
    best_epoch: int | None
    valid_loss: float | None
    valid_flown_safe_share: float | None
    valid_flown_fuel: float | None
    valid_flown_trials: float | None
    seconds: float | None
    device: str | None
    threads: str | None
    weights_kib: float | None


@dataclass(frozen=True)
class Epoch:
    """One epoch of a training.

    Attributes:
        arch: architecture.
        recipe: how it was trained.
        training_seed: of the training.
        epoch: its number.
        train_loss: on the training data.
        valid_loss: on the validation data.
    """

    arch: str
    recipe: str
    training_seed: int
    epoch: int
    train_loss: float
    valid_loss: float
