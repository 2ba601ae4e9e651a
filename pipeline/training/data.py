"""Examples on their way into training: checked, encoded, on the device."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.dataset.examples import Examples
from pipeline.errors import InputError
from pipeline.networks.encoding import Encoding


@dataclass(frozen=True, eq=False)
class Encoded:
    """Examples as a network reads them, float32, all on one device.

    Attributes:
        inputs: what it reads.
        target: what it should answer.
    """

    inputs: Float[Tensor, "N n T 6"]
    target: Float[Tensor, "N n T 6"]

    def __len__(self) -> int:
        """Number of instances."""
        return len(self.inputs)


def encoded(examples: Examples, encoding: Encoding, device: torch.device) -> Encoded:
    """The examples, encoded, on a device."""
    inputs = encoding.inputs(examples.initial, examples.goal)
    target = encoding.targets(examples.states, inputs)
    return Encoded(inputs.float().to(device), target.float().to(device))


def check_examples(train: Examples, valid: Examples) -> None:
    """Refuse examples that nothing can be learnt from.

    Raises:
        InputError: where either is empty or holds values that are not finite numbers, or where
            the two differ in swarm size or problem.
    """
    for name, examples in (("training", train), ("validation", valid)):
        if len(examples) == 0:
            raise InputError(f"there are no {name} examples; expected at least one: add more data.")
        for field in ("initial", "goal", "states"):
            bad = ~np.isfinite(getattr(examples, field)).reshape(len(examples), -1).all(axis=1)
            if bad.any():
                raise InputError(
                    f"{name} example {bad.argmax()} has {field} that are not finite numbers; "
                    "verify the dataset or make it again."
                )
    if (valid.n, valid.problem) != (train.n, train.problem):
        raise InputError(
            f"validation examples have n = {valid.n} and {valid.problem}; expected those of the "
            f"training examples, n = {train.n} and {train.problem}."
        )
