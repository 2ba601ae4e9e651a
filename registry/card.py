"""The model card that goes with an exported network: what it takes, gives, and is worth."""

from collections.abc import Mapping, Sequence

from pipeline.networks.model import Model
from pipeline.networks.onnx_check import TOLERANCE
from pipeline.networks.onnx_export import Exported
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
    parts = (
        f"# {version.name}, version {version.version}\n",
        _purpose(version, exported),
        _file(exported, sha256),
        _interface(model, exported),
        _training(version, model),
        _worth(version, measured),
        _limits(model, exported),
    )
    return "\n".join(parts)


def _purpose(version: ModelVersion, exported: Exported) -> str:
    what = "a transfer that can be flown" if exported.flown else "a prediction of the transfer"
    return (
        f"A network of the architecture `{version.arch}`, trained by the recipe "
        f"`{version.recipe}`. From the present and the wanted state of each spacecraft of a swarm "
        f"it gives {what} that the convex expert would plan. Registered as `{version.uri}`, "
        f"training run `{version.run_id}`.\n"
    )


def _file(exported: Exported, sha256: str) -> str:
    checked = exported.checked
    rows = [(n, f"{seconds * 1e3:.3f}") for n, seconds in checked.seconds.items()]
    return (
        "## File\n\n"
        f"`{exported.path.name}`: ONNX, {exported.kib:.0f} KiB, sha256 `{sha256}`.\n\n"
        f"Swarms: {checked.sizes}. onnxruntime's answer differs from torch's by at most "
        f"{checked.difference:.1e} of a component's root mean square ({checked.metres:.1e} m in "
        f"position), measured at the sizes below; {TOLERANCE:g} was allowed. Time of one "
        "instance in onnxruntime on one core of the machine that exported it:\n\n"
        + _table(("n", "ms"), rows)
    )


def _interface(model: Model, exported: Exported) -> str:
    T = model.problem.nodes
    state = "x y z (m), vx vy vz (m/s)"
    rows = [
        ("input", "`initial`", "(batch, n, 6)", f"{state} at the first node"),
        ("input", "`goal`", "(batch, n, 6)", f"{state} at the last node"),
        ("output", "`states`", f"(batch, n, {T}, 6)", f"{state} at each node"),
    ]
    if exported.flown:
        held = "x y z (m/s²), held constant over each interval"
        rows.append(("output", "`controls`", f"(batch, n, {T - 1}, 3)", held))
    scales = (
        f"inside the file, nothing is left to do: a component is divided by "
        f"{_numbers(model.encoding.input_scale)} on its way in, and the answer multiplied by "
        f"{_numbers(model.encoding.target_scale)}"
    )
    return (
        "## Inputs and outputs\n\n"
        + _table(("", "name", "shape, float32", "content"), rows)
        + "\nLVLH frame: x radial outward, y along-track, z cross-track. Scaling is "
        f"{scales} (target: `{model.encoding.target}`, input between the ends: "
        f"`{model.encoding.interior}`).\n"
    )


def _training(version: ModelVersion, model: Model) -> str:
    problem, params = model.problem, version.params
    rows = [
        ("dataset", f"`{params.get('dataset', 'unknown')}`"),
        ("digest", f"`{version.dataset_digest or 'unknown'}`"),
        ("instances", f"{params.get('train_instances')} + {params.get('valid_instances')}"),
        ("spacecraft in each", model.n_train),
        ("mean motion", f"{problem.mean_motion:.9g} rad/s"),
        ("nodes, step", f"{problem.nodes}, {problem.time_step:g} s"),
        ("collision radius", f"{problem.collision_radius:g} m"),
        ("weights", params.get("parameters", "unknown")),
        ("seed, code", f"{params.get('seed')}, `{version.tags.get('git_commit', 'unknown')}`"),
    ]
    return "## Training\n\n" + _table(("", ""), rows)


def _worth(version: ModelVersion, measured: Mapping[str, Mapping[int, float]]) -> str:
    rmse = version.metrics.get("valid_position_rmse")
    told = "not recorded" if rmse is None else f"{rmse:.3g} m"
    lead = (
        "## Measured\n\nRoot mean square distance of predicted positions from the expert's, on "
        f"validation data: {told}.\n\n"
    )
    known = {name: by_n for name, by_n in measured.items() if by_n}
    if not known:
        return lead + "Safety and fuel were **not measured**: run `prolearn evaluate` first.\n"
    sizes = sorted({n for by_n in known.values() for n in by_n})
    rows = [(n, *(_number(by_n.get(n)) for by_n in known.values())) for n in sizes]
    return (
        lead
        + "Means over the test trials of `prolearn evaluate`, flown unless said otherwise (safe: "
        "no pair comes within the collision radius at any time):\n\n"
        + _table(("n", *(BY_SIZE[name] for name in known)), rows)
    )


def _limits(model: Model, exported: Exported) -> str:
    flown = (
        "The controls meet the goal and the states obey the dynamics, to float32's accuracy."
        if exported.flown
        else "States are as predicted: they miss both ends and break the dynamics. Export with "
        "`--flown` for controls that can be flown."
    )
    return (
        "## Limits\n\n"
        f"- {flown}\n"
        "- Nothing here keeps spacecraft apart: the share of unsafe plans is above. Check a plan, "
        "or let the expert make it safe, before it is flown.\n"
        f"- Made for one orbit and time grid (above), and learnt from swarms of n = "
        f"{model.n_train} in that dataset; anything else was not measured.\n"
        "- A limit on the acceleration and the collision radius are not inputs.\n"
    )


def _table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "".join("| " + " | ".join(str(cell) for cell in line) + " |\n" for line in lines)


def _numbers(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.4g}" for value in values)


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"
