"""The model card of a refiner's part for one craft: its steps, and what craft tell each other."""

from collections.abc import Mapping, Sequence

from cli.stages.card import by_size, training
from pipeline.markdown import Markdown, code, table
from pipeline.networks.model import Model
from pipeline.networks.refiner.best import STEADY
from pipeline.networks.refiner.on_board.check import TOLERANCE
from pipeline.networks.refiner.on_board.export import ExportedCraft
from pipeline.networks.refiner.on_board.steps import STEPS, outputs, takes
from pipeline.networks.refiner.on_board.values import value
from pipeline.networks.refiner.rounds import SAFE
from pipeline.templates import template
from registry.version import ModelVersion


def craft_card(
    version: ModelVersion | None,
    model: Model,
    exported: ExportedCraft,
    measured: Mapping[str, Mapping[int, float]],
) -> str:
    """The card as Markdown.

    Args:
        version: what the registry knows about the model; None for the packaged one.
        model: the network.
        exported: the files and what was measured of them.
        measured: metrics of experiment 2 by name, then by swarm size.
    """
    messages = [(code(name), count, _content(name)) for name, count in exported.told.items()]
    return template("cli/stages/craft_card.md.jinja").render(
        version=version,
        recipe=model.recipe,
        checked=exported.checked,
        tolerance=f"{TOLERANCE:g}",
        rounds=model.config["rounds"],
        files=_files(exported),
        safe=f"{SAFE:g}",
        steady=f"{STEADY:g}",
        told=exported.told,
        messages=table(("name", "numbers", "content"), messages),
        steps={name: _interface(name) for name in STEPS},
        T=model.problem.nodes,
        H=model.config["message"],
        training=training(version, model),
        measured=by_size(measured),
    )


def _files(exported: ExportedCraft) -> Markdown:
    rows = [
        (
            code(f"{name}.onnx"),
            f"{exported.kib[name]:.0f}",
            f"{exported.checked.seconds[name] * 1e3:.2g}",
            Markdown(" ".join(map(code, step.tells))),
            code(exported.sha256[name][:16]),
        )
        for name, step in STEPS.items()
    ]
    return table(("file", "KiB", "ms", "tells", "sha256, beginning"), rows)


def _interface(name: str) -> Markdown:
    step = STEPS[name]
    named = [("input", one) for one in takes(step)] + [("output", one) for one in outputs(step)]
    rows = [(way, code(one), _shape(one), _type(one), _content(one)) for way, one in named]
    return table(("", "name", "shape", "type", "content"), rows)


def _content(name: str) -> Markdown:
    return Markdown(value(name).what)  # ours, and written as such


def _shape(name: str) -> str:
    sizes: Sequence[int | str] = value(name).shape
    return f"({', '.join(map(str, sizes))})" if sizes else "one number"


def _type(name: str) -> str:
    return str(value(name).dtype).removeprefix("torch.")
