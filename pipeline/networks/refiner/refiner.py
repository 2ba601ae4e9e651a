"""The refiner as an architecture: rounds of bargaining that end with the cheapest safe iterate.

It learns from no plans, but for an ablation that does. What it makes small is fuel over the lower
bound, and what encounters lack of the collision radius, in the iterates of every round, the later
the more. Swarms of ten craft become as crowded as larger ones by raising the collision radius as
far as both formations allow: in units of r_col nothing else of a swarm matters.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, cast

import torch
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor, nn

from pipeline.errors import InputError
from pipeline.networks.architecture import Answer
from pipeline.networks.encoding import Encoding
from pipeline.networks.recipes import COSINE, Recipe
from pipeline.networks.refiner.ablations import (
    EPOCHS,
    LABELLED,
    NO_THIRD,
    SHORT,
    TUNED,
    UNCROWDED,
    UNSAFE,
)
from pipeline.networks.refiner.bargain import Bargain
from pipeline.networks.refiner.best import best_of, refined
from pipeline.networks.refiner.rounds import WATCHED, State, Task, begin, play, start
from pipeline.networks.swarms import Batch, Swarms
from pipeline.orbit.separation import drift_separations

CROWDED = 1.02
"""Separation in free drift that raised collision radii leave at least, in r_col."""

RAISED = 2.5
"""Most by which they are raised; what is more crowded is hardly to be planned by anybody."""

NO_FUEL = 1e-9
"""Fuel in r_col/Δt² that counts as none."""

AT_ONCE = 500
"""Formations whose free drift is looked at together."""


class Sizes(BaseModel):
    """Sizes of a refiner.

    Attributes:
        width: of hidden layers.
        message: numbers in a message.
        rounds: that an answer takes.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    width: int = Field(ge=1, le=4096, strict=True)
    message: int = Field(ge=1, le=4096, strict=True)
    rounds: int = Field(ge=0, le=1000, strict=True)


class Lesson(BaseModel):
    """The options of a refiner's recipe.

    Attributes:
        rounds: in training.
        violation: what a r_col that an encounter lacks counts as, as fuel over the lower bound.
        clear: distance beyond r_col up to which an encounter lacks something, r_col; nobody is seen
            beyond ``WATCHED``.
        earlier: what a round counts for the one after it.
        raised: whether collision radii are raised.
        third: whether sides hear of the other sides of both craft.
        labels: what a r_col of average distance from the expert's nodes counts as, where it has
            planned; these swarms' collision radii are not raised then.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    rounds: int = Field(default=8, ge=1)
    violation: float = 2.5
    clear: float = Field(default=0.008, ge=0, le=WATCHED - 1)
    earlier: float = 0.5
    raised: bool = True
    third: bool = True
    labels: float = Field(default=0.0, ge=0)


@dataclass(frozen=True)
class Refiner:
    """An ``Architecture`` that answers with controls.

    Attributes:
        width: of hidden layers.
        message: numbers in a message.
        rounds: that an answer takes.
    """

    width: int = 32
    message: int = 16
    rounds: int = 14

    @property
    def config(self) -> Mapping[str, Any]:
        """Its sizes."""
        return {"width": self.width, "message": self.message, "rounds": self.rounds}

    @property
    def recipes(self) -> Mapping[str, Mapping[str, Any]]:
        """One that learns from fuel and separation, without plans; and what it is tried against."""
        tuned = {
            "learning_rate": 2e-3,
            "batch_size": 32,
            "epochs": 25,
            "patience": 25,
            "crowded": 8000,
            "schedule": COSINE,
            "gradient_limit": 1.0,
            "averaging": 0.998,
            "options": _options(),
        }
        short = {**tuned, "epochs": EPOCHS}
        return {
            TUNED: tuned,
            SHORT: short,
            NO_THIRD: {**short, "options": _options(third=False)},
            UNCROWDED: {**short, "options": _options(raised=False), "crowded": 0},
            LABELLED: {**short, "options": _options(labels=0.1)},
        }

    @property
    def unused(self) -> frozenset[str]:
        """What encodes the swarms of the paper's networks, and what they alone have."""
        return frozenset({"dropout", "interior", "target", "scaling", "collision_weight"})

    @property
    def answers(self) -> Answer:
        """Controls, which meet the goal but for rounding."""
        return "controls"

    @property
    def objective(self) -> str:
        """The score."""
        return "best_valid_loss"

    def network(self, config: Mapping[str, Any], encoding: Encoding, dropout: float) -> nn.Module:
        """The network that the sides of encounters share; it has no dropout."""
        sizes = Sizes.model_validate(dict(config))
        return Bargain(sizes.width, sizes.message, sizes.rounds)

    def prepare(self, swarms: Swarms, encoding: Encoding) -> Batch:
        """Ends, collision radii and those to which they may be raised, and plans: m and m/s."""
        given = {"initial": swarms.initial, "goal": swarms.goal, "radius": swarms.collision_radius}
        apart = torch.full_like(swarms.collision_radius, torch.inf)
        for k in range(0, len(apart), AT_ONCE):
            for ends in (swarms.initial, swarms.goal):
                found = drift_separations(ends[k : k + AT_ONCE].numpy(), swarms.problem)
                apart[k : k + AT_ONCE] = apart[k : k + AT_ONCE].minimum(torch.from_numpy(found))
        radius = swarms.collision_radius
        given["states"] = _known(swarms).float()
        return {**given, "most": (apart / CROWDED).clamp(min=radius, max=RAISED * radius)}

    def loss(
        self, network: nn.Module, batch: Batch, encoding: Encoding, recipe: Recipe
    ) -> Float[Tensor, ""]:
        """Fuel over the lower bound and what encounters lack, by the logarithm, over all rounds."""
        lesson, bargain = Lesson.model_validate(dict(recipe.options)), _bargain(network)
        bargain.hears.fill_(float(lesson.third))  # before the first step, kept with the weights
        if lesson.labels and recipe.draws:
            raise InputError(
                f"labels is {lesson.labels:g} and draws {recipe.draws}, whose scenarios nobody has "
                "planned; expected labels 0, or draws 0 to learn from a dataset's plans."
            )
        given = _turned(_crowded(batch, encoding, lesson))
        task, terms = begin(given), []
        state = start(task)
        for number in range(lesson.rounds):
            state = play(bargain, task, state, number)
            lack = lesson.violation * state.lack(task, 1 + lesson.clear)
            # By its logarithm, or the hardest swarms would be all that is learned from.
            terms.append(torch.log(_ratio(task, state.controls) + lack).mean())
            if given.states is not None:
                apart = _from_expert(given.states, given.collision_radius, state)
                terms[-1] = terms[-1] + lesson.labels * apart
        weight = torch.tensor([lesson.earlier**k for k in reversed(range(len(terms)))])
        mean = (torch.stack(terms) * weight.to(lack)).sum() / weight.sum()
        return mean + 0.0 * bargain.offer.weight.sum()  # a gradient also where nobody meets

    def score(
        self, network: nn.Module, batch: Batch, encoding: Encoding, recipe: Recipe
    ) -> Float[Tensor, ""]:
        """The same of answers, with a price on unsafe swarms, as they are and crowded."""
        bargain, crowded = _bargain(network), {**batch, "radius": batch["most"]}
        scores = []
        for given in (batch, crowded):
            task = begin(_as_given(given, encoding))
            controls, safe = best_of(bargain, task, bargain.rounds)
            scores.append((_ratio(task, controls).log() + UNSAFE * ~safe).mean())
        return torch.stack(scores).mean()

    def answer(
        self, network: nn.Module, swarms: Swarms, encoding: Encoding
    ) -> Float[Tensor, "b n _ 3"]:
        """The cheapest safe iterate of each swarm, or else the last, m/s²."""
        bargain, device = _bargain(network), next(network.parameters()).device
        there = Swarms(
            swarms.problem,
            swarms.initial.to(device),
            swarms.goal.to(device),
            swarms.collision_radius.to(device),
        )
        return refined(bargain, there, bargain.rounds)


def _options(**changes: Any) -> dict[str, Any]:
    """A recipe's options, as plain JSON values."""
    return Lesson(**changes).model_dump(mode="json")


def _bargain(network: nn.Module) -> Bargain:
    """What ``Refiner.network`` made, which the protocol knows as any module."""
    return cast("Bargain", network)


def _ratio(task: Task, controls: Float[Tensor, "N m"]) -> Float[Tensor, "b"]:
    """Fuel over the lower bound of each swarm, 1 where none is needed."""
    bound = task.fuel(task.own.controls)
    return task.fuel(controls).clamp(min=NO_FUEL) / bound.clamp(min=NO_FUEL)


def _as_given(batch: Batch, encoding: Encoding) -> Swarms:
    return Swarms(encoding.problem, batch["initial"], batch["goal"], batch["radius"])


def _known(swarms: Swarms) -> Float[Tensor, "b n T 6"]:
    """The expert's states; not numbers where it has not planned."""
    if swarms.states is not None:
        return swarms.states
    b, n, _ = swarms.initial.shape
    return swarms.initial.new_full((b, n, swarms.problem.nodes, 6), torch.nan)


def _crowded(batch: Batch, encoding: Encoding, lesson: Lesson) -> Swarms:
    """Collision radii somewhere between what they are and the most that they may be.

    Those of plans that are learned from stay.
    """
    given = _as_given(batch, encoding)
    least, most = batch["radius"], batch["most"]
    radius = least + (most - least) * torch.rand_like(least) if lesson.raised else least
    if not lesson.labels:
        return replace(given, collision_radius=radius)
    states = batch["states"].double()
    radius = torch.where(states.isnan().flatten(1).any(dim=1), radius, least)
    return replace(given, collision_radius=radius, states=states)


def _from_expert(
    expert: Float[Tensor, "b n T 6"], radius: Float[Tensor, "b"], state: State
) -> Float[Tensor, ""]:
    """Average distance of nodes from the expert's, r_col; 0 in swarms that it has not planned."""
    wanted = expert[..., :3] / radius[:, None, None, None]
    apart = state.states[..., :3] - wanted.flatten(0, 1)
    return torch.linalg.vector_norm(apart.nan_to_num(), dim=2).mean()


def _turned(swarms: Swarms) -> Swarms:
    """The same swarms seen in a mirror or from behind, which linear motion does not notice."""
    half = swarms.collision_radius.new_full((2, len(swarms.initial)), 0.5)
    behind, mirror = 1 - 2 * torch.bernoulli(half)
    axes = torch.ones(len(behind), 1, 6, dtype=behind.dtype, device=behind.device)
    axes[:, :, 2::3] = mirror[:, None, None]  # out of plane: z and its velocity
    turn = axes * behind[:, None, None]
    states = None if swarms.states is None else swarms.states * turn[:, :, None]
    return replace(swarms, initial=swarms.initial * turn, goal=swarms.goal * turn, states=states)


REFINER = Refiner()
