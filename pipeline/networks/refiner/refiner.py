"""The refiner as an architecture: its network, recipe, loss and score.

It learns without plans: the loss combines fuel over its lower bound and the shortfall of separation
in the iterates of all rounds, of which later ones weigh more. Raised collision radii, as far as
both formations allow, make swarms of ten craft as crowded as larger ones: only lengths in units of
r_col matter.
"""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import torch
from pydantic import Field
from torch import Tensor, nn

from pipeline.arrays import Float, plain
from pipeline.documents import Strict
from pipeline.networks.architecture import Swarms, TensorBatch
from pipeline.networks.document import Answer
from pipeline.networks.encoding import Encoding
from pipeline.networks.recipes import COSINE, Recipe
from pipeline.networks.refiner import model
from pipeline.orbit.separation import drift_separations

UNSAFE = 0.1  # added to the score of an unsafe swarm, the log of fuel over the lower bound
CROWDED = 1.02  # least separation in free drift, in units of the raised collision radius
RAISED = 2.5  # largest factor by which radii are raised; denser swarms can hardly be planned
NO_FUEL = 1e-9  # fuel in r_col/Δt² that counts as none
AT_ONCE = 500  # number of formations whose free drift is computed at once


class Sizes(Strict):
    """Sizes of a refiner: of hidden layers and messages, and the rounds that an answer takes."""

    width: int = Field(default=32, ge=1, le=4096, strict=True)
    message: int = Field(default=16, ge=1, le=4096, strict=True)
    rounds: int = Field(default=14, ge=0, le=1000, strict=True)


class LossSettings(Strict):
    """The options of a refiner's recipe, which weigh missing separation against fuel."""

    rounds: int = Field(default=8, ge=1)  # in training
    violation: float = 2.5  # weight of missing separation: of fuel over the bound, per r_col
    # margin beyond r_col below which separation is missing, in r_col; ``PLANE_DISTANCE`` limits it
    clear: float = Field(default=0.008, ge=0, le=model.PLANE_DISTANCE - 1)
    earlier: float = 0.5  # weight of a round, relative to that of the next


class MessagePassing(nn.Module):
    """The weights of the network; ``model.trades`` is its forward pass. Untrained, trades are 0."""

    hears: Float[Tensor, ""]  # 1, stored with the weights; 0 in models trained without messages

    def __init__(self, width: int, message: int, rounds: int) -> None:
        super().__init__()
        self.message, self.rounds = message, rounds
        self.read = _two_layers(2 * model.FEATURES, width, message)
        self.weigh = _two_layers(5 * message, width, message)
        self.tell = nn.Linear(message, message)
        self.offer = nn.Linear(message, 1, bias=False)
        nn.init.zeros_(self.offer.weight)
        self.register_buffer("hears", torch.ones(()))

    @property
    def weights(self) -> model.Weights:
        """The weights by name, with their gradients."""
        return dict(self.state_dict(keep_vars=True))

    @property
    def arrays(self) -> model.Weights:
        """The weights by name, as numpy arrays."""
        return {name: plain(values) for name, values in self.weights.items()}


def _two_layers(before: int, width: int, after: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(before, width), nn.SiLU(), nn.Linear(width, after))


class Refiner:
    """An ``Architecture`` that answers with controls."""

    config: ClassVar[Mapping[str, Any]] = Sizes().model_dump()
    answers: ClassVar[Answer] = "controls"
    objective: ClassVar[str] = "best_valid_loss"
    unused: ClassVar[frozenset[str]] = frozenset(
        {"dropout", "interior", "target", "scaling", "collision_weight"}
    )

    # The recipe that learns from fuel and separation, without plans
    recipes: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "tuned": {
            "learning_rate": 2e-3,
            "batch_size": 32,
            "epochs": 25,
            "patience": 25,
            "crowded": 8000,
            "schedule": COSINE,
            "gradient_limit": 1.0,
            "averaging": 0.998,
            "options": LossSettings().model_dump(),
        }
    }

    def network(self, config: Mapping[str, Any], encoding: Encoding, dropout: float) -> nn.Module:
        """The network, whose weights all encounters share; it has no dropout."""
        sizes = Sizes.model_validate(dict(config))
        return MessagePassing(sizes.width, sizes.message, sizes.rounds)

    def prepare(self, swarms: Swarms, encoding: Encoding) -> TensorBatch:
        """Initial and goal states, m and m/s, collision radii, and the largest raised ones, m."""
        radius = swarms.collision_radius
        ends = torch.split(torch.cat([swarms.initial, swarms.goal]), AT_ONCE)
        separations = [drift_separations(some.numpy(), swarms.problem) for some in ends]
        closest = torch.from_numpy(np.concatenate(separations)).reshape(2, -1).amin(dim=0)
        most = (closest / CROWDED).clamp(min=radius, max=RAISED * radius)
        return {"initial": swarms.initial, "goal": swarms.goal, "radius": radius, "most": most}

    def loss(
        self, network: MessagePassing, batch: TensorBatch, encoding: Encoding, recipe: Recipe
    ) -> Float[Tensor, ""]:
        """Log of fuel over the lower bound plus separation shortfall, averaged over rounds."""
        settings = LossSettings.model_validate(dict(recipe.options))
        initial, goal, radius = _augmented(batch)
        data = model.problem_data(encoding.problem, initial, goal, radius, initial.device)
        terms = []
        now, weights = model.start(data), network.weights
        for number in range(settings.rounds):
            now = model.run_round(weights, data, now, number)
            missing = settings.violation * model.shortfall(data, now, 1 + settings.clear)
            # The logarithm keeps the hardest swarms from dominating the loss.
            terms.append(torch.log(_ratio(data, now.controls) + missing).mean())
        weight = torch.tensor([settings.earlier**k for k in reversed(range(len(terms)))])
        mean = (torch.stack(terms) * weight.to(terms[0])).sum() / weight.sum()
        return mean + 0.0 * network.offer.weight.sum()  # a gradient also without encounters

    @torch.no_grad()
    def score(
        self, network: MessagePassing, batch: TensorBatch, encoding: Encoding, recipe: Recipe
    ) -> Float[Tensor, ""]:
        """Mean log of fuel over its bound, plus a penalty if unsafe, at given and raised radii."""
        scores = []
        for radius in (batch["radius"], batch["most"]):
            data = model.problem_data(encoding.problem, batch["initial"], batch["goal"], radius)
            controls, safe = model.cheapest_safe(network.arrays, data, network.rounds)
            ratio = _ratio(data, torch.from_numpy(controls))
            scores.append((ratio.log() + UNSAFE * torch.from_numpy(~safe)).mean())
        return torch.stack(scores).mean()

    def answer(
        self, network: MessagePassing, swarms: Swarms, encoding: Encoding
    ) -> Float[Tensor, "b n _ 3"]:
        """Controls of the cheapest safe iterate of each swarm, or else of the last one, m/s²."""
        trained = model.TrainedRefiner(
            network.arrays, network.rounds, swarms.problem, digest="", device=swarms.device
        )
        found = trained.controls(swarms.initial, swarms.goal, swarms.collision_radius)
        return torch.from_numpy(found)


def _ratio(data: model.ProblemData, controls: Float[Tensor, "N m"]) -> Float[Tensor, "b"]:
    """Fuel over the lower bound of each swarm, 1 where none is needed."""
    bound = data.fuel(torch.from_numpy(data.own.controls).to(controls))
    return data.fuel(controls).clamp(min=NO_FUEL) / bound.clamp(min=NO_FUEL)


def _augmented(
    batch: TensorBatch,
) -> tuple[Float[Tensor, "b n 6"], Float[Tensor, "b n 6"], Float[Tensor, "b"]]:
    """Both ends, negated or mirrored in z at random, as linear motion allows, and raised radii."""
    least, most = batch["radius"], batch["most"]
    radius = least + (most - least) * torch.rand_like(least)
    negate, mirror = 1 - 2 * torch.bernoulli(radius.new_full((2, len(radius)), 0.5))
    signs = negate[:, None, None].repeat(1, 1, 6)
    signs[:, :, 2::3] *= mirror[:, None, None]  # out of plane: z and its velocity
    return batch["initial"] * signs, batch["goal"] * signs, radius


REFINER = Refiner()
