"""Time of a training epoch, beside that of its optimizer steps alone and of a DataLoader loop.

    python -m benchmarks.training --out reports/bench

Each network is trained in four ways that take turns, so that the machine's load affects all
alike; times are wall-clock times, since loaders work in other processes, with torch on one
thread. Prints a table, and writes training.json.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from timeit import timeit
from typing import Annotated

import numpy as np
import torch
import typer
from torch import Tensor
from torch.utils.data import DataLoader, TensorDataset

from benchmarks.tables import BENCH, OutOption, TableRow, quartiles, show, write_json
from pipeline.dataset.examples import Examples
from pipeline.expert import decoupled_optima
from pipeline.networks.architecture import find, recipe_for
from pipeline.networks.encoding import fit
from pipeline.networks.recipes import Recipe
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import fly
from pipeline.scenario import draw
from pipeline.training.data import Prepared, prepare
from pipeline.training.loop import Descent, TrainingObjective, pass_over

SEED = 2022
N = 10
CPU = torch.device("cpu")

ROUNDS = {"ff1": 9, "ff2": 9, "ffcol": 9, "lstm1": 5, "lstm2": 5}
"""Number of epochs of each way, by network."""

OURS = "prolearn"
STEPS = "steps alone"
"""The steps of an epoch on batches that were cut beforehand: what no epoch can go below."""

TorchBatches = Iterable[Sequence[Tensor]]  # inputs and targets
RunEpoch = Callable[[], object]


def main(
    out: OutOption = BENCH,
    instances: Annotated[int, typer.Option(help="Instances of a feed-forward epoch.")] = 8000,
    recurrent: Annotated[int, typer.Option(help="Instances of an LSTM's epoch, slow ones.")] = 256,
) -> None:
    """Run all and print a table."""
    torch.set_num_threads(1)
    many, few = _examples(instances), _examples(recurrent)
    rows: list[TableRow] = []
    for arch, rounds in ROUNDS.items():
        rows += _rows(arch, few if arch.startswith("lstm") else many, rounds)
    show("One training epoch: its time, and over that of its steps alone and of ours", rows)
    write_json(out / "training.json", rows)


def _examples(count: int) -> Examples:
    """Scenarios of the reference problem with decoupled optima, much cheaper than plans are."""
    problem = Problem()
    scenarios = [draw("rings", SEED, N, index, problem) for index in range(count)]
    initial = np.stack([s.initial for s in scenarios])
    goal = np.stack([s.goal for s in scenarios])
    controls = np.stack([decoupled_optima(s.initial, s.goal, problem).controls for s in scenarios])
    return Examples(problem, initial, goal, fly(initial, controls, problem))


def _rows(arch: str, examples: Examples, rounds: int) -> list[TableRow]:
    recipe = recipe_for(arch, "tuned")
    ways = _ways(arch, recipe, examples)
    taken = [[timeit(epoch, number=1) for epoch in ways.values()] for _ in range(rounds + 1)]
    seconds = dict(zip(ways, np.array(taken[1:]).T, strict=True))  # the first round warms up
    return [
        {
            "network": arch,
            "instances": len(examples),
            "batch": recipe.batch_size,
            "epoch": name,
            "median_s": float(np.median(times)),
            "quartiles_s": quartiles(times),
            "over_steps": float(np.median(times / seconds[STEPS])),
            "quartiles": quartiles(times / seconds[STEPS]),
            "over_ours": float(np.median(times / seconds[OURS])),
        }
        for name, times in seconds.items()
    ]


def _ways(arch: str, recipe: Recipe, examples: Examples) -> Mapping[str, RunEpoch]:
    """Ways to train for an epoch, each with a network of its own."""
    architecture = find(arch)
    encoding = fit(examples, recipe.interior, recipe.target, recipe.scaling)
    data, size = prepare(architecture, encoding, CPU, examples), recipe.batch_size
    order = torch.Generator().manual_seed(SEED)

    def fresh() -> tuple[TrainingObjective, Descent]:
        network = architecture.network(architecture.config, encoding, recipe.dropout)
        descent = Descent(network, recipe, steps=1)
        return TrainingObjective(architecture, network, encoding, recipe), descent

    def plain(batches: TorchBatches) -> RunEpoch:
        objective, descent = fresh()
        return lambda: _plain_epoch(objective, descent.optimizer, batches)

    objective, descent = fresh()
    instances = TensorDataset(data.tensors["inputs"], data.tensors["target"])
    cut = [(batch.tensors["inputs"], batch.tensors["target"]) for batch in data.in_order(size)]
    return {
        OURS: lambda: pass_over(objective, descent, data, order),
        STEPS: plain(cut),
        "loader": plain(DataLoader(instances, size, shuffle=True)),
        "loader, 2 workers": plain(DataLoader(instances, size, shuffle=True, num_workers=2)),
    }


def _plain_epoch(
    objective: TrainingObjective, optimizer: torch.optim.Optimizer, batches: TorchBatches
) -> float:
    objective.network.train()
    total = 0.0
    for inputs, target in batches:
        optimizer.zero_grad()
        loss = objective.loss(Prepared({"inputs": inputs, "target": target}))
        torch.autograd.backward(loss)
        optimizer.step()
        total += loss.item()
    return total


if __name__ == "__main__":
    typer.run(main)
