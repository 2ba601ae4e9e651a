"""A registered model as a file for on-board use, with its model card beside it."""

import hashlib
from collections.abc import Mapping
from pathlib import Path

from pipeline.errors import InputError
from pipeline.files import refuse_stdio, refuse_unwritable, write_text
from pipeline.markup import Markdown, code, formatted, table, template
from pipeline.networks.model import Model
from pipeline.networks.model import load as load_network
from pipeline.networks.onnx_export import TOLERANCE, Exported
from pipeline.networks.onnx_export import export as export_onnx
from pipeline.networks.recipes import REFINER
from pipeline.networks.refiner.model import FOLDER, SAFE, STEADY
from pipeline.networks.refiner.on_board import STEPS, outputs, value
from pipeline.networks.refiner.on_board_export import TOLERANCE as CRAFT_TOLERANCE
from pipeline.networks.refiner.on_board_export import ExportedCraft, export_craft
from registry.metrics import model_metrics_by_size
from registry.models import PREFIX, ModelVersion, load

PACKAGED = "packaged"  # the refiner that comes with the package, which is in no registry
# A dataset's digest, and metrics of experiment 2 on it by name, then by swarm size
Measured = tuple[str, Mapping[str, Mapping[int, float]]]

# Metrics of experiment 2 in the card, with their headings
BY_SIZE = {
    "exp2_flown_trials": "trials",
    "exp2_flown_safe_share": "safe share",
    "exp2_flown_collisions": "node collisions",
    "exp2_flown_fuel": "fuel, m/s²",
    "exp2_flown_fuel_ratio": "fuel / lower bound",
    "exp2_predicted_collisions": "as predicted: node collisions",
    "exp2_predicted_boundary_error": "as predicted: miss of the ends, m",
}
STATE = "x y z (m), vx vy vz (m/s)"
HELD = "x y z (m/s²), held constant over each interval"


def file_name(version: ModelVersion | None) -> str:
    """Default name of the file of a model, or of the packaged refiner."""
    if version is None:
        return f"{PREFIX}{REFINER}-{PACKAGED}.onnx"
    return f"{version.name}-v{version.version}.onnx"


def refuse_options(version: ModelVersion | None, n: int | None, *, flown: bool) -> None:
    """Raise InputError where n or ``flown`` is given for a refiner."""
    refiner = version is None or version.arch == REFINER
    if refiner and (n is not None or flown):
        raise InputError(
            f"--n or --flown is given for {version.name if version else PACKAGED}; expected "
            "neither: its files are for one craft of any swarm, and give controls to be flown."
        )


def export(
    reference: str | ModelVersion | None,
    out: Path | None = None,
    *,
    n: int | None = None,
    flown: bool = False,
) -> tuple[Exported | ExportedCraft, Path]:
    """Export a registered model or the packaged refiner (None) as ONNX; the path is its card's.

    A refiner becomes a folder of files, and takes neither n nor ``flown``. Other files are for n
    craft, by default any number that the architecture answers for; ``flown`` projects predictions
    onto transfers that can be flown. ProlearnError where a file does not answer as the model does.
    """
    model, version = (load_network(FOLDER), None) if reference is None else load(reference)
    refuse_options(version, n, flown=flown)
    names = () if version is None else ("uri", "run_id", "dataset_digest")
    known = {"uri": PACKAGED} | {name: getattr(version, name) for name in names}
    measured = ("", {}) if version is None else model_metrics_by_size(version, BY_SIZE)
    about = {
        **known,
        "arch": model.architecture,
        "recipe": model.recipe,
        "n_spacecraft": model.n_train,
        "mean_motion": model.problem.mean_motion,
        "time_step": model.problem.time_step,
        "nodes": model.problem.nodes,
        "units": {"states": "m, m/s", "controls": "m/s^2"},
    }
    path = out or Path(file_name(version))
    supervised = None if model.architecture == REFINER else version
    if supervised is None and path.suffix == ".onnx":
        path = path.with_suffix("")
    card = path.with_name(path.name + ".md")
    refuse_stdio(path)
    refuse_unwritable(card)  # before tracing, which takes up to a minute
    made: Exported | ExportedCraft
    if supervised is None:
        made = export_craft(model, path, about=about)
        text = _craft_card(version, model, made, measured)
    else:
        made = export_onnx(model, path, n=n, flown=flown, about=about)
        text = _model_card(supervised, model, made, measured)
    write_text(card, text)
    return made, card


def _model_card(version: ModelVersion, model: Model, exported: Exported, measured: Measured) -> str:
    rmse = version.metrics.get("valid_position_rmse")
    times = [(n, f"{seconds * 1e3:.3f}") for n, seconds in exported.seconds.items()]
    nodes = model.problem.nodes
    interface = [
        ("input", code("initial"), "(batch, n, 6)", f"{STATE} at the first node"),
        ("input", code("goal"), "(batch, n, 6)", f"{STATE} at the last node"),
        ("output", code("states"), f"(batch, n, {nodes}, 6)", f"{STATE} at each node"),
    ]
    if exported.flown:
        interface.append(("output", code("controls"), f"(batch, n, {nodes - 1}, 3)", HELD))
    return template("cli/jobs/card.md.jinja").render(
        version=version,
        exported=exported,
        encoding=model.encoding,
        sha256=hashlib.sha256(exported.path.read_bytes()).hexdigest(),
        tolerance=f"{TOLERANCE:g}",
        input_scale=", ".join(f"{scale:.4g}" for scale in model.encoding.input_scale),
        target_scale=", ".join(f"{scale:.4g}" for scale in model.encoding.target_scale),
        rmse="not recorded" if rmse is None else f"{rmse:.3g} m",
        times=table(("n", "ms"), times),
        interface=table(("", "name", "shape, float32", "content"), interface),
        training=_training(version, model),
        data=measured[0],
        measured=_by_size(measured[1]),
    )


def _craft_card(
    version: ModelVersion | None, model: Model, exported: ExportedCraft, measured: Measured
) -> str:
    files = [
        (
            code(f"{name}.onnx"),
            f"{exported.kib[name]:.0f}",
            f"{exported.seconds[name] * 1e3:.2g}",
            Markdown(" ".join(map(code, step.tells))),
            code(exported.sha256[name][:16]),
        )
        for name, step in STEPS.items()
    ]
    messages = [(code(name), count, _content(name)) for name, count in exported.told.items()]
    return template("cli/jobs/craft_card.md.jinja").render(
        version=version,
        recipe=model.recipe if version is None else version.recipe,
        exported=exported,
        config=model.config,
        tolerance=f"{CRAFT_TOLERANCE:g}",
        files=table(("file", "KiB", "ms", "tells", "sha256, beginning"), files),
        safe=f"{SAFE:g}",
        steady=f"{STEADY:g}",
        messages=table(("name", "numbers", "content"), messages),
        steps={name: _step_interface(name) for name in STEPS},
        T=model.problem.nodes,
        training=_training(version, model),
        data=measured[0],
        measured=_by_size(measured[1]),
    )


def _step_interface(name: str) -> Markdown:
    step = STEPS[name]
    rows = []
    for kind, names in (("input", step.takes), ("output", outputs(step))):
        for one in names:
            sizes, dtype = value(one).shape, str(value(one).dtype).removeprefix("torch.")
            shape = f"({', '.join(map(str, sizes))})" if sizes else "one number"
            rows.append((kind, code(one), shape, dtype, _content(one)))
    return table(("", "name", "shape", "type", "content"), rows)


def _content(name: str) -> Markdown:
    return Markdown(value(name).meaning)  # ours, and written as such


def _training(version: ModelVersion | None, model: Model) -> Markdown:
    problem = model.problem
    rows: list[tuple[str, object]] = [
        ("spacecraft in each", model.n_train),
        ("mean motion", f"{problem.mean_motion:.9g} rad/s"),
        ("nodes, step", f"{problem.nodes}, {problem.time_step:g} s"),
        ("collision radius", f"{problem.collision_radius:g} m"),
    ]
    if version is not None:
        params, commit = version.params, version.tags.get("git_commit", "unknown")
        rows = [
            ("dataset", code(params.get("dataset", "unknown"))),
            ("digest", code(version.dataset_digest or "unknown")),
            ("instances", f"{params.get('train_instances')} + {params.get('valid_instances')}"),
            *rows,
            ("weights", params.get("parameters", "unknown")),
            ("seed, code", formatted("{}, {}", params.get("seed"), code(commit))),
        ]
    return table(("", ""), rows)


def _by_size(measured: Mapping[str, Mapping[int, float]]) -> Markdown:
    known = {name: measured[name] for name in BY_SIZE if name in measured}
    if not known:
        return Markdown()
    sizes = sorted({n for by_n in known.values() for n in by_n})
    rows = [(n, *(_short(m[n]) if n in m else "" for m in known.values())) for n in sizes]
    return table(("n", *(BY_SIZE[name] for name in known)), rows)


def _short(value: float) -> str:
    return f"{value:.0f}" if value.is_integer() else f"{value:.3g}"
