"""Settings of the jobs, a frozen dataclass each, and options that several commands have.

The annotated fields become Typer's options (``cli.options.with_settings``); the jobs read the same
values, and those of experiments become MLflow's parameters by the names of their fields.
"""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from cli.options import architectures, families, planners
from pipeline.errors import InputError

if TYPE_CHECKING:
    from pipeline.flight.conditions import Conditions
    from pipeline.orbit.problem import Problem
    from pipeline.orbit.reference_orbit import ReferenceOrbit
    from pipeline.plan import RiskLimit
    from pipeline.scenario import Scenario


def option(text: str, *names: str, **more: Any) -> Any:
    """An option with a help text, and names where they are not those of the field."""
    return typer.Option(*names, help=text, **more)


def flag(name: str, text: str) -> Any:
    """An option without a value."""
    return typer.Option(name, help=text)


_thrust = partial(option, rich_help_panel="Thrusters and burns")
_states = partial(option, rich_help_panel="Inertial states of your own")
_condition = partial(option, rich_help_panel="Conditions of the flight")
_trial = partial(option, rich_help_panel="Trials with errors")

AsJson = Annotated[bool, flag("--json", "Print one JSON document, and all else on stderr.")]
Jobs = Annotated[int, option("Processes; -1 for all cores.")]
Separation = Annotated[
    Literal["continuous", "nodes"], option("Keep craft apart at all times, or at the nodes only.")
]
Effort = Literal["first", "default", "best"]
Family = Annotated[
    str,
    option(
        "rings, dense, coplanar-split, tilt-split, independent or rotation.",
        autocompletion=families,
    ),
]
PlanFile = Annotated[Path, typer.Argument(help="Plan file; - is standard input.")]

Data = Annotated[str, option("Solved dataset, a folder or a URL.")]
TrainingSize = Annotated[int, option("Swarm size to train on.")]
Device = Annotated[str, option("auto, cpu, cuda or mps.")]
Resume = Annotated[
    bool,
    flag(
        "--resume",
        "Nothing to do where data, models, settings and versions are as before; a run that was "
        "killed goes on.",
    ),
]


@dataclass(frozen=True)
class ExperimentSettings:
    """Settings that all experiments have."""

    models: Annotated[
        str | None, option("Such as ff1,lstm2:paper; by default the newest trained on the data.")
    ] = None
    data: Annotated[str, option("Solved dataset, folder or URL: its test split.")] = "data/paper"
    trials: Annotated[int | None, option("Most trials of each size.")] = None


@dataclass(frozen=True)
class Evaluation(ExperimentSettings):
    """Settings of experiments 1 and 2."""

    sizes: Annotated[
        str | None, option("Swarm sizes, such as 2..30; by default all of the dataset.", "--n")
    ] = None
    timed: Annotated[int, option("Trials of each size that are timed.")] = 10


@dataclass(frozen=True)
class WarmStarts(ExperimentSettings):
    """Settings of experiment 3."""

    optimizer: Annotated[
        Literal["expert", "plain"], option("Our expert, or the paper's kind: a plain SCP at nodes.")
    ] = "expert"
    sizes: Annotated[
        str | None, option("Swarm sizes; by default 10,30, or 10 for the plain SCP.", "--n")
    ] = None
    trials: Annotated[int | None, option("Trials of each size.")] = 100


@dataclass(frozen=True)
class TransferTimes(ExperimentSettings):
    """Settings of experiment 4."""

    n: Annotated[int, option("Swarm size.")] = 10
    nodes: Annotated[str, option("Numbers of nodes T, at the time step of the training.")] = "6..21"
    time_steps: Annotated[
        str | None,
        option("Time steps Δt, s; by default those with the durations of --nodes.", "--time-step"),
    ] = None
    trials: Annotated[int | None, option("Most trials of each transfer time.")] = 100


@dataclass(frozen=True)
class Flights(ExperimentSettings):
    """Settings of experiment 5."""

    models: Annotated[
        str | None,
        option("For any time grid, such as refiner,lstm2; by default the newest refiners."),
    ] = None
    n: Annotated[int, option("Swarm size.")] = 10
    trials: Annotated[int | None, option("Most scenarios.")] = 100
    flights: Annotated[int, option("Flights of each scenario, each with other errors.")] = 10
    seed: Annotated[int, option("Root seed of the errors.")] = 0


@dataclass(frozen=True)
class TrainingSettings:
    """Settings of a training except architecture and seed; some replace fields of its recipe."""

    recipe: Annotated[
        str, option("paper, tuned (on validation), or one of the architecture's own.")
    ] = "tuned"
    data: Data = "data/paper"
    n: TrainingSize = 10
    epochs: Annotated[int | None, option("Most epochs.")] = None
    interior: Annotated[
        str | None, option("Input between the end states: line, zeros or minimum-energy.")
    ] = None
    learning_rate: Annotated[float | None, option("Of Adam.")] = None
    dropout: Annotated[float | None, option("Share of hidden outputs dropped in training.")] = None
    batch_size: Annotated[int | None, option("Instances a step.")] = None
    collision_weight: Annotated[
        float | None, option("Weight of the collision penalty (ffcol, lstmcol).")
    ] = None
    crowded: Annotated[
        int | None, option("Crowded scenarios that the refiner learns from beside the data.")
    ] = None
    device: Device = "auto"
    memory: Annotated[
        float, option("GB that data may take; larger datasets stream shard by shard.")
    ] = 2.0


@dataclass(frozen=True, kw_only=True)
class TuningSettings:
    """Settings of a search for hyperparameters."""

    arch: Annotated[str, option("Architecture, such as lstm2.", autocompletion=architectures)]
    trials: Annotated[int, option("Trials in all, earlier ones included.")] = 20
    recipe: Annotated[str, option("Recipe that the trials start from.")] = "tuned"
    data: Data = "data/paper"
    n: TrainingSize = 10
    epochs: Annotated[int | None, option("Most epochs of a trial.")] = None
    device: Device = "auto"
    seed: Annotated[int, option("Of the search and of each training.")] = 0
    storage: Annotated[
        Path | None, option("Optuna's SQLite file; optuna.db beside mlflow.db by default.")
    ] = None


@dataclass(frozen=True)
class WorkerSettings:
    """The processes that do the work, here or on a Dask cluster."""

    jobs: Jobs = -1
    backend: Annotated[
        Literal["loky", "dask"], option("Where workers run: this machine, or a Dask cluster.")
    ] = "loky"
    scheduler: Annotated[
        str | None, option("Of Dask, such as tcp://10.0.0.1:8786.", envvar="DASK_SCHEDULER_ADDRESS")
    ] = None
    scheduler_wait: Annotated[
        float | None, option("Seconds in which a lost scheduler may come back; 300 by default.")
    ] = None


@dataclass(frozen=True)
class RunSettings(WorkerSettings):
    """How an experiment is run: by whom, whether an earlier run counts, and what is printed."""

    resume: Resume = False
    as_json: AsJson = False


@dataclass(frozen=True)
class TrainingWorkers(WorkerSettings):
    """The processes that train, by default the command's own."""

    jobs: Annotated[
        int, option("Trainings at once, each on one thread and with its data in memory; -1: cores.")
    ] = 1


@dataclass(frozen=True)
class ProblemSettings:
    """Orbit, time grid, collision radius and thrust limit of a problem."""

    altitude: Annotated[float, option("Of the reference orbit, m.")] = 500e3
    time_step: Annotated[float, option("Length of an interval, s.")] = 120.0
    nodes: Annotated[int, option("Time nodes.")] = 11
    collision_radius: Annotated[float, option("r_col, m.")] = 15.0
    max_acceleration: Annotated[float | None, option("Limit on each component, m/s².")] = None

    def problem(self) -> "Problem":
        """The problem on a circular orbit so high above the Earth; InputError for a wrong value."""
        from pipeline.orbit.problem import Problem
        from pipeline.orbit.reference import mean_motion_at

        if not self.altitude > 0:
            raise InputError(
                f"--altitude is {self.altitude}; expected a positive number of metres."
            )
        others = {name: value for name, value in vars(self).items() if name != "altitude"}
        return Problem(mean_motion_at(self.altitude), **others)


@dataclass(frozen=True)
class ThrustSettings:
    """Thrusters, their limits, and what is asked of burns; the same for every craft."""

    thrust: Annotated[
        Literal["components", "norm"],
        _thrust("Thrusters along the axes, or one that is pointed; directions go into the file."),
    ] = "components"
    max_acceleration_norm: Annotated[
        float | None, _thrust("Limit on the norm of the control, m/s².")
    ] = None
    min_delta_v: Annotated[
        float | None, _thrust("Smallest impulse bit: least Δv of a burn, m/s.")
    ] = None
    no_burn: Annotated[
        list[str] | None,
        _thrust("No burns from and to, s, such as 300:500. Again for more.", metavar="FROM:TO"),
    ] = None
    delta_v: Annotated[float | None, _thrust("What each craft may burn in all, m/s.")] = None
    objective: Annotated[
        Literal["total", "fair"],
        _thrust("Least fuel of all, or the least largest share of what craft have left."),
    ] = "total"

    def fields(self, n: int) -> dict[str, Any]:
        """What is given, as fields of a scenario file of n craft."""
        given = {k: v for k, v in vars(self).items() if v != getattr(ThrustSettings, k)}
        if self.no_burn:
            given["no_burn"] = [_window(text) for text in self.no_burn]
        if (left := given.pop("delta_v", None)) is not None:
            given["craft"] = [{"delta_v": left}] * n
        return given


def _window(text: str) -> list[float]:
    try:
        begin, end = map(float, text.split(":"))
    except ValueError:
        raise InputError(
            f"--no-burn is {text!r}; expected from and to in s, such as 300:500."
        ) from None
    return [begin, end]


@dataclass(frozen=True)
class InertialFiles:
    """Files with the inertial states of craft at both ends, and the orbit that they are about."""

    initial: Annotated[
        Path | None,
        _states("Inertial states at the first node: folder of OEM files, OEM, CSV or JSON."),
    ] = None
    goal: Annotated[Path | None, _states("Likewise at the last node.")] = None
    chief: Annotated[
        Path | None,
        _states(
            "Likewise of one craft at the first node, whose orbit is the reference; by default "
            "the mean of --initial."
        ),
    ] = None
    ballistic: Annotated[float | None, _states("Add drag: mean C_D A/m, m²/kg.", "--drag")] = None
    spread: Annotated[
        float | None, _states("By what share the first has less, the last more.", "--drag-spread")
    ] = None

    def scenario(self, problem: "Problem", epoch: str | None, *, j2: bool) -> "Scenario":
        """The scenario of the states on a time grid; InputError for files that do not fit."""
        from pipeline.scenario.fields import utc
        from pipeline.scenario.inertial import scenario_from_inertial
        from pipeline.scenario.state_files import read_inertial

        if self.initial is None or self.goal is None:
            raise InputError(
                "--initial or --goal is missing; expected both where one of these, --chief or "
                "--drag is given."
            )
        _refuse_spread_alone(self)
        try:
            first = None if epoch is None else utc(epoch)
        except ValueError as error:
            raise InputError(f"--epoch is {epoch!r}: {error}.") from error
        return scenario_from_inertial(
            read_inertial(self.initial),
            read_inertial(self.goal),
            problem,
            chief=None if self.chief is None else read_inertial(self.chief),
            epoch=first,
            j2=j2,
            ballistic=self.ballistic,
            spread=self.spread or 0.0,
        )


def _refuse_spread_alone(drag: "InertialFiles | FlightConditions") -> None:
    if drag.spread is not None and drag.ballistic is None:
        raise InputError(
            f"--drag-spread is {drag.spread:g} without --drag; expected both: add --drag 0.01."
        )


ANGLES = ("inclination_deg", "raan_deg", "argument_of_latitude_deg")  # of an orbit's place


@dataclass(frozen=True)
class OrbitPlace:
    """Where and when the orbit of a new scenario is, and its shape if it is no circle."""

    epoch: Annotated[
        str | None,
        option(
            "Of the first node, such as 2026-03-01T12:00:00Z; with the three angles below the "
            "file says where its orbit is."
        ),
    ] = None
    inclination_deg: Annotated[
        float | None,
        option("Of the orbit, deg; 97.4 by default with --eccentricity.", "--inclination"),
    ] = None
    raan_deg: Annotated[
        float | None, option("Right ascension of its ascending node, deg.", "--raan")
    ] = None
    argument_of_latitude_deg: Annotated[
        float | None, option("Of the origin at the first node, deg.", "--argument-of-latitude")
    ] = None
    eccentricity: Annotated[
        float | None,
        option(
            "An orbit with J2 instead of a circle, by mean elements; --altitude is then that of "
            "its semi-major axis."
        ),
    ] = None
    argument_of_perigee_deg: Annotated[
        float, option("Of that orbit, deg.", "--argument-of-perigee")
    ] = 90.0
    no_j2: Annotated[bool, flag("--no-j2", "Leave J2 out of it.")] = False

    def orbit(self, altitude: float) -> "ReferenceOrbit":
        """The orbit of these mean elements, its semi-major axis so many m above the Earth."""
        from pipeline.orbit.reference import R_EARTH
        from pipeline.orbit.reference_orbit import ReferenceOrbit

        inclination = 97.4 if self.inclination_deg is None else self.inclination_deg
        return ReferenceOrbit.of_mean(
            semi_major_axis=R_EARTH + altitude,
            eccentricity=self.eccentricity or 0.0,
            inclination_deg=inclination,
            raan_deg=self.raan_deg or 0.0,
            argument_of_perigee_deg=self.argument_of_perigee_deg,
            argument_of_latitude_deg=self.argument_of_latitude_deg or 0.0,
            j2=not self.no_j2,
        )

    def at(self, orbit: "ReferenceOrbit") -> "OrbitPlace":
        """The same with the osculating angles of an orbit, which the file has, if at an epoch."""
        angles = (
            dict.fromkeys(ANGLES) if self.epoch is None else {k: vars(orbit)[k] for k in ANGLES}
        )
        return replace(self, **angles)


ErrorPreset = Literal["cold-gas", "calibrated", "uncalibrated", "electric", "none"]


@dataclass(frozen=True)
class RiskSettings:
    """A chance constraint on separation, and the errors that it is about."""

    asked: Annotated[
        float | None,
        option("Most probability that a pair ever comes within r_col, with errors.", "--risk"),
    ] = None
    navigation_sigma: Annotated[
        float | None, option("With --risk: sigma of each component of known positions, m.")
    ] = None
    thrust_sigma: Annotated[
        float | None,
        option(
            "With --risk: sigma of each burn's size, as a share of it, and of its direction about "
            "each axis across it, rad."
        ),
    ] = None
    velocity_sigma: Annotated[
        float | None,
        option("Likewise of velocities, m/s; by default the mean motion times --navigation-sigma."),
    ] = None

    errors: Annotated[
        ErrorPreset | None,
        option("Instead of sigmas: errors as of `prolearn fly`, but for missed burns."),
    ] = None
    closed_loop: Annotated[
        bool,
        flag("--closed-loop", "Corrected at each node, from states known with the same errors."),
    ] = False

    def limit(self) -> "RiskLimit | None":
        """The limit on the risk, if any; InputError for one without errors, or errors without."""
        from pipeline.plan import RiskLimit

        given = {
            name: value for name, value in vars(self).items() if value not in (None, False, "none")
        }
        if not given:
            return None
        if [*given] == ["closed_loop"]:
            raise InputError(
                "--closed-loop is given without --risk; expected the probability that craft may "
                "come too close with it, such as --risk 1e-3 --navigation-sigma 0.2."
            )
        errors = given.keys() - {"asked", "closed_loop"}
        if not errors:
            raise InputError(
                f"--risk is {self.asked:g} and no error is given; expected --navigation-sigma, "
                "--thrust-sigma, --velocity-sigma or several of them with it, or --errors cold-gas."
            )
        if self.errors is not None and len(errors) > 1:
            raise InputError(
                f"--errors is {self.errors} and a sigma is given besides; expected one of the two."
            )
        if self.asked is None:
            raise InputError(
                "a sigma is given without --risk; expected the probability that craft may come too "
                "close with it, such as --risk 1e-3."
            )
        if self.errors is not None:
            from pipeline.flight.errors import PRESETS

            given["errors"] = PRESETS[self.errors]
        return RiskLimit(**given)


@dataclass(frozen=True)
class FlightConditions:
    """Conditions of a flight, by mean elements; None leaves a value to the scenario."""

    eccentricity: Annotated[float, _condition("Mean, of the reference orbit, up to 0.85.")] = 0.001
    inclination_deg: Annotated[
        float | None,
        _condition("Mean, deg; by default the scenario's, else 97.4.", "--inclination"),
    ] = None
    raan_deg: Annotated[
        float | None,
        _condition("Right ascension of its node, deg; the scenario's, else 0.", "--raan"),
    ] = None
    argument_of_perigee_deg: Annotated[
        float, _condition("Mean, from the ascending node, deg.", "--argument-of-perigee")
    ] = 90.0
    argument_of_latitude_deg: Annotated[
        float | None,
        _condition("At the first node, deg; the scenario's, else 0.", "--argument-of-latitude"),
    ] = None
    no_j2: Annotated[bool, _condition("Leave the Earth's oblateness out.", "--no-j2")] = False
    ballistic: Annotated[
        float | None, _condition("Add drag: mean C_D A/m, m²/kg; a CubeSat's is 0.01.", "--drag")
    ] = None
    spread: Annotated[
        float | None,
        _condition(
            "By what share the first has less, the last more.  [default: 0.1]", "--drag-spread"
        ),
    ] = None

    def about(self, scenario: "Scenario") -> "Conditions":
        """The conditions, and where the options say nothing the scenario's reference orbit."""
        from pipeline.flight.conditions import conditions_of

        _refuse_spread_alone(self)
        given = {k: v for k, v in vars(self).items() if v is not None and k != "no_j2"}
        return replace(conditions_of(scenario), **given, j2=not self.no_j2)


@dataclass(frozen=True)
class FlownTrials:
    """Settings of a plan that is flown many times with errors."""

    trials: Annotated[int | None, _trial("Fly so many times, with errors that differ.")] = None
    seed: Annotated[int, _trial("Root seed of the errors.")] = 0
    errors: Annotated[ErrorPreset, _trial("Size of the errors, to begin with.")] = "cold-gas"
    error: Annotated[
        list[str] | None,
        _trial(
            "Change one: magnitude=0.05. Names: position, velocity, position_bias, velocity_bias, "
            "semi_major_axis, navigation_time, latency, magnitude, direction, magnitude_fixed, "
            "direction_fixed, magnitude_bias, direction_bias, impulse_bit, timing, missed, lost.",
            metavar="NAME=VALUE",
        ),
    ] = None
    world: Annotated[
        Literal["nonlinear", "linear"], _trial("The conditions above, or the model of planners.")
    ] = "nonlinear"
    replan: Annotated[
        Literal["none", "feedback", "every-node"],
        _trial("Compare with craft corrected, or planned anew, at every node."),
    ] = "none"
    planner: Annotated[
        str, _trial("Who plans anew, as for `prolearn plan`.", autocompletion=planners)
    ] = "expert"
    effort: Annotated[Effort | None, _trial("Of the expert then, as for `prolearn plan`.")] = None
    sigmas: Annotated[
        float | None,
        _trial("Standard deviations of separations kept beyond r_col then; 3 by default."),
    ] = None
    size: Annotated[float, _trial("Distance of two centres at which craft may touch, m.")] = 0.35
    out: Annotated[Path | None, _trial("Folder; PLAN-flown by default.")] = None


@dataclass(frozen=True, kw_only=True)
class Planning:
    """Settings of who plans, and what of a plan."""

    planner: Annotated[
        str,
        option(
            "expert, refiner, minimum-energy, straight-line, decoupled-optimum, or a model (ff1, "
            "...).",
            autocompletion=planners,
        ),
    ] = "expert"
    separation: Separation = "continuous"
    effort: Annotated[
        Effort | None,
        option(
            "Of the expert: stop at the first safe plan, as soon as it no longer improves, or at "
            "the best of several searches. By default the second; after a model, the first, and "
            "after the refiner that only where it has no safe plan."
        ),
    ] = None
    assignment: Annotated[
        Literal["given", "optimal"],
        option("Who takes which goal: as given, or such that the fuel is least."),
    ] = "given"
    allow_drift: Annotated[
        bool, flag("--allow-drift", "Accept states that are not energy-matched.")
    ] = False


@dataclass(frozen=True, kw_only=True)
class Tradeoff(Planning):
    """Settings of a trade-off of fuel against transfer time."""

    duration: Annotated[str, option("Range of transfer times: 10..60min, 600..3600s.")]
    steps: Annotated[int, option("Durations at most, spread over the range.")] = 20
    goal: Annotated[
        Literal["fixed", "moving"],
        option(
            "Goals are the states given, whenever they are reached, or slots that move on along "
            "their passive orbits and are there after the scenario's own duration."
        ),
    ] = "fixed"
    out: Annotated[Path | None, option("Folder; SCENARIO-tradeoff by default.")] = None
