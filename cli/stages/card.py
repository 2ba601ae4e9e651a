"""The model card that goes with an exported network: what it takes, gives, and is worth."""

from collections.abc import Mapping, Sequence

from pipeline.markdown import Markdown, code, formatted, table
from pipeline.networks.model import Model
from pipeline.networks.onnx_check import TOLERANCE
from pipeline.networks.onnx_export import Exported
from pipeline.templates import template
from registry.version import ModelVersion

BY_SIZE = {
    "exp2_flown_safe_share": "safe share",
    "exp2_flown_collisions": "node collisions",
    "exp2_flown_fuel": "fuel, m/s²",
    "exp2_flown_fuel_ratio": "fuel / lower bound",
    "exp2_predicted_collisions": "as predicted: node collisions",
    "exp2_predicted_boundary_error": "as predicted: miss of the ends, m",
}
"""Metrics of experiment 2 in the card, with their headings."""

STATE = "x y z (m), vx vy vz (m/s)"
HELD = "x y z (m/s²), held constant over each interval"


def model_card(
    version: ModelVersion,
    model: Model,
    exported: Exported,
    measured: Mapping[str, Mapping[int, float]],
    sha256: str,
) -> str:
    """The card as Markdown.

    Args:
        version: what the registry knows about the model.
        model: the network.
        exported: the file and what was measured of it.
        measured: metrics of experiment 2 by name, then by swarm size.
        sha256: digest of the file.
    """
    checked, rmse = exported.checked, version.metrics.get("valid_position_rmse")
    times = [(n, f"{seconds * 1e3:.3f}") for n, seconds in checked.seconds.items()]
    return template("cli/stages/card.md.jinja").render(
        version=version,
        exported=exported,
        checked=checked,
        encoding=model.encoding,
        sha256=sha256,
        tolerance=f"{TOLERANCE:g}",
        input_scale=_numbers(model.encoding.input_scale),
        target_scale=_numbers(model.encoding.target_scale),
        rmse="not recorded" if rmse is None else f"{rmse:.3g} m",
        times=table(("n", "ms"), times),
        interface=_interface(model.problem.nodes, flown=exported.flown),
        training=training(version, model),
        measured=by_size(measured),
    )


def _interface(T: int, *, flown: bool) -> Markdown:
    rows = [
        ("input", code("initial"), "(batch, n, 6)", f"{STATE} at the first node"),
        ("input", code("goal"), "(batch, n, 6)", f"{STATE} at the last node"),
        ("output", code("states"), f"(batch, n, {T}, 6)", f"{STATE} at each node"),
        ("output", code("controls"), f"(batch, n, {T - 1}, 3)", HELD),
    ]
    return table(("", "name", "shape, float32", "content"), rows if flown else rows[:-1])


def training(version: ModelVersion | None, model: Model) -> Markdown:
    """What it was trained on, as far as the registry or the model itself knows."""
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


def by_size(measured: Mapping[str, Mapping[int, float]]) -> Markdown:
    """A row for each swarm size; nothing where nothing was measured."""
    measured = {name: by_n for name, by_n in measured.items() if by_n}
    if not measured:
        return Markdown()
    sizes = sorted({n for by_n in measured.values() for n in by_n})
    rows = [(n, *(f"{m[n]:.3g}" if n in m else "" for m in measured.values())) for n in sizes]
    return table(("n", *(BY_SIZE[name] for name in measured)), rows)


def _numbers(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.4g}" for value in values)
