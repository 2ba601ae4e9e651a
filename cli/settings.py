"""Settings of the jobs, a frozen dataclass each, and options that several commands have.

Their fields become Typer's options (``cli.options.with_settings``); the jobs read the same
values, and those of experiments become MLflow's parameters by the names of their fields.
"""

from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import typer

from cli.options import OPTION, architectures, families, planners
from pipeline.errors import InputError

if TYPE_CHECKING:
    from pipeline.flight.world import Conditions
    from pipeline.orbit.problem import Problem
    from pipeline.orbit.reference_orbit import ReferenceOrbit
    from pipeline.plan.requirements import RiskLimit
    from pipeline.scenario import Scenario


def option(text: str, *names: str, **more: Any) -> Any:
    """An option with a help text, and names where they are not those of the field."""
    return typer.Option(*names, help=text, **more)


def setting(text: str, *names: str, default: Any = None, **more: Any) -> Any:
    """A field of settings with its default, and the option that it becomes."""
    return field(default=default, metadata={OPTION: option(text, *names, **more)})


_thrust = partial(setting, rich_help_panel="Thrusters and burns")
_states = partial(setting, rich_help_panel="Inertial states of your own")
_condition = partial(setting, rich_help_panel="Conditions of the flight")
_trial = partial(setting, rich_help_panel="Trials with errors")

AsJson = Annotated[bool, option("Print one JSON document, and all else on stderr.", "--json")]
SeparationOption = Annotated[
    Literal["continuous", "nodes"], option("Keep craft apart at all times, or at the nodes only.")
]
EffortOption = Literal["first", "default", "best"]
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
Device = Annotated[str, option("auto, cpu, cuda or, not for the refiner, mps.")]
RefinerDevice = Annotated[
    Literal["cpu", "cuda"] | None,
    option("Where refiners plan, by torch in float64; on the CPU by compiled code if not given."),
]
Resume = Annotated[
    bool,
    option(
        "Skip if the same run (data, models, settings, versions) is recorded already; continue one "
        "that was killed.",
        "--resume",
    ),
]


@dataclass(frozen=True)
class ExperimentSettings:
    """Settings that all experiments have."""

    models: str | None = setting(
        "Such as ff1,lstm2:paper; by default the newest trained on the data."
    )
    data: str = setting("Solved dataset, folder or URL: its test split.", default="data/paper")
    trials: int | None = setting("Maximum number of trials of each size.")


@dataclass(frozen=True)
class Evaluation(ExperimentSettings):
    """Settings of experiments 1 and 2."""

    sizes: str | None = setting("Swarm sizes, such as 2..30; by default all of the dataset.", "--n")
    timed: int = setting("Trials of each size that are timed.", default=10)
    device: RefinerDevice = None


@dataclass(frozen=True)
class WarmStarts(ExperimentSettings):
    """Settings of experiment 3."""

    optimizer: Literal["expert", "plain"] = setting(
        "Our expert, or the paper's kind: a plain SCP at nodes.", default="expert"
    )
    sizes: str | None = setting("Swarm sizes; by default 10,30, or 10 for the plain SCP.", "--n")
    trials: int | None = setting("Trials of each size.", default=100)


@dataclass(frozen=True)
class TransferTimes(ExperimentSettings):
    """Settings of experiment 4."""

    n: int = setting("Swarm size.", default=10)
    nodes: str = setting("Numbers of nodes T, at the time step of the training.", default="6..21")
    time_steps: str | None = setting(
        "Time steps Δt, s; by default those with the durations of --nodes.", "--time-step"
    )
    trials: int | None = setting("Maximum number of trials of each transfer time.", default=100)
    device: RefinerDevice = None


@dataclass(frozen=True)
class Flights(ExperimentSettings):
    """Settings of experiment 5."""

    models: str | None = setting(
        "For any time grid, such as refiner,lstm2; by default the newest refiners."
    )
    n: int = setting("Swarm size.", default=10)
    trials: int | None = setting("Maximum number of scenarios.", default=100)
    flights: int = setting("Flights of each scenario, each with other errors.", default=10)
    seed: int = setting("Root seed of the errors.", default=0)


@dataclass(frozen=True)
class TrainingSettings:
    """Settings of a training except architecture and seed; some replace fields of its recipe."""

    recipe: str = setting(
        "paper, tuned (on validation), or one of the architecture's own.", default="tuned"
    )
    data: Data = "data/paper"
    n: TrainingSize = 10
    epochs: int | None = setting("Maximum number of epochs.")
    interior: str | None = setting("Input between the end states: line, zeros or minimum-energy.")
    learning_rate: float | None = setting("Of Adam.")
    dropout: float | None = setting("Share of hidden outputs dropped in training.")
    batch_size: int | None = setting("Instances a step.")
    collision_weight: float | None = setting("Weight of the collision penalty (ffcol, lstmcol).")
    crowded: int | None = setting("Crowded scenarios that the refiner learns from, too.")
    device: Device = "auto"
    memory: float = setting(
        "GB that data may take; larger datasets stream shard by shard.", default=2.0
    )


@dataclass(frozen=True, kw_only=True)
class TuningSettings:
    """Settings of a search for hyperparameters."""

    arch: Annotated[str, option("Architecture, such as lstm2.", autocompletion=architectures)]
    trials: int = setting("Trials in all, earlier ones included.", default=20)
    at_once: int = setting(
        "Trials that are drawn together, from what was done before; as many can train at once.",
        default=1,
    )
    recipe: str = setting("Recipe that the trials start from.", default="tuned")
    data: Data = "data/paper"
    n: TrainingSize = 10
    epochs: int | None = setting("Maximum number of epochs of a trial.")
    device: Device = "auto"
    seed: int = setting("Of the search and of each training.", default=0)
    storage: Path | None = setting("Optuna's SQLite file; optuna.db beside mlflow.db by default.")
    memory: ClassVar[float] = TrainingSettings.memory


@dataclass(frozen=True)
class WorkerSettings:
    """The processes that do the work."""

    jobs: int = setting("Processes; -1 for all cores.", default=-1)
    backend: Literal["loky", "dask"] = setting(
        "Where workers run: this machine, or a Dask cluster.", default="loky"
    )
    scheduler: str | None = setting(
        "Address of Dask's scheduler, such as tcp://10.0.0.1:8786.", envvar="DASK_SCHEDULER_ADDRESS"
    )
    scheduler_wait: float | None = setting(
        "Seconds in which a lost scheduler may come back; 300 by default."
    )


@dataclass(frozen=True)
class FolderWorkers(WorkerSettings):
    """The processes that work on the shards of a folder."""

    shared: bool = setting(
        "Dask's workers reach the folder, too, and read and write shards themselves.",
        "--shared",
        default=False,
    )


@dataclass(frozen=True)
class RunSettings(WorkerSettings):
    """Settings of every experiment: workers, reuse of an earlier run, and printed output."""

    resume: Resume = False
    as_json: AsJson = False


@dataclass(frozen=True)
class TrainingWorkers(WorkerSettings):
    """The processes that train, by default the command's own."""

    jobs: int = setting(
        "Trainings at once, each on one thread and with its data in memory; -1: cores.", default=1
    )


@dataclass(frozen=True)
class ProblemSettings:
    """Orbit, time grid, collision radius and thrust limit of a problem."""

    altitude: float = setting("Of the reference orbit, m.", default=500e3)
    time_step: float = setting("Length of an interval, s.", default=120.0)
    nodes: int = setting("Time nodes.", default=11)
    collision_radius: float = setting("r_col, m.", default=15.0)
    max_acceleration: float | None = setting("Limit on each component, m/s².")

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
    """Thrusters, their limits, and requirements on burns; the same for every craft."""

    thrust: Literal["components", "norm"] = _thrust(
        "Thrusters along the axes, or one that is pointed; for others edit the file.",
        default="components",
    )
    max_acceleration_norm: float | None = _thrust("Limit on the norm of the control, m/s².")
    min_delta_v: float | None = _thrust("Minimum impulse bit: least Δv of a burn, m/s.")
    no_burn: list[str] | None = _thrust(
        "Time span without burns, start:end in s, such as 300:500. Repeat the option for more.",
        metavar="START:END",
    )
    delta_v: float | None = _thrust("What each craft may burn in all, m/s.")
    objective: Literal["total", "fair"] = _thrust(
        "What is minimized: the fuel of all, or the largest share of its Δv that a craft burns.",
        default="total",
    )

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
            f"--no-burn is {text!r}; expected start:end in s, such as 300:500."
        ) from None
    return [begin, end]


@dataclass(frozen=True)
class InertialFiles:
    """Files with the inertial states of craft at both ends, and the orbit that they are about."""

    initial: Path | None = _states(
        "Inertial states at the first node: folder of OEM files, OEM, CSV or JSON."
    )
    goal: Path | None = _states("Inertial states at the last node, in any of these forms.")
    chief: Path | None = _states(
        "Inertial state of the chief at the first node, whose orbit is the reference; by default "
        "the mean of --initial."
    )
    ballistic: float | None = _states("With --initial: drag, mean C_D A/m, m²/kg.", "--drag")
    spread: float | None = _states(
        "With --initial: relative spread of C_D A/m over the swarm: first craft less, last more.",
        "--drag-spread",
    )

    def scenario(self, problem: "Problem", epoch: str | None, *, j2: bool) -> "Scenario":
        """The scenario of the states on a time grid; InputError for files that do not fit."""
        from pipeline.scenario.inertial import read_inertial, scenario_from_inertial
        from pipeline.scenario.part_documents import utc

        if self.initial is None or self.goal is None:
            raise InputError(
                "--initial or --goal is missing; expected both with either of them or --chief."
            )
        _check_drag(self)
        try:
            first = None if epoch is None else utc(epoch)
        except ValueError as error:
            raise InputError(f"--epoch is {epoch!r}: {error}.") from error
        read = cache(read_inertial)  # one file may be all three, and standard input is there once
        return scenario_from_inertial(
            read(self.initial),
            read(self.goal),
            problem,
            chief=None if self.chief is None else read(self.chief),
            epoch=first,
            j2=j2,
            ballistic=self.ballistic,
            spread=self.spread or 0.0,
        )


def _check_drag(drag: "InertialFiles | FlightConditions") -> None:
    from pipeline.orbit.reference_orbit import check_drag

    if drag.spread is not None and drag.ballistic is None:
        raise InputError(
            f"--drag-spread is {drag.spread:g} without --drag; expected both: add --drag 0.01."
        )
    check_drag(drag.ballistic, drag.spread or 0.0, ("--drag", "--drag-spread"))


ANGLES = ("inclination_deg", "raan_deg", "argument_of_latitude_deg")  # of an orbit's place


@dataclass(frozen=True)
class OrbitPlace:
    """Where and when the orbit of a new scenario is, and its shape if it is not circular."""

    epoch: str | None = setting(
        "Of the first node, such as 2026-03-01T12:00:00Z; with the three angles below the "
        "file says where its orbit is."
    )
    inclination_deg: float | None = setting(
        "Of the orbit, deg; 97.4 by default with --eccentricity.", "--inclination"
    )
    raan_deg: float | None = setting("Right ascension of its ascending node, deg.", "--raan")
    argument_of_latitude_deg: float | None = setting(
        "Of the origin at the first node, deg.", "--argument-of-latitude"
    )
    eccentricity: float | None = setting(
        "An orbit with J2 instead of a circle, by mean elements; --altitude is then that of "
        "its semi-major axis."
    )
    argument_of_perigee_deg: float = setting(
        "Of that orbit, deg.", "--argument-of-perigee", default=90.0
    )
    no_j2: bool = setting("Leave J2 out of it.", "--no-j2", default=False)

    def orbit(self, altitude: float) -> "ReferenceOrbit":
        """The orbit of these mean elements, its semi-major axis so many m above the Earth."""
        from pipeline.flight.world import Conditions
        from pipeline.orbit.reference import R_EARTH

        left_out = ("epoch", "no_j2")
        given = {k: v for k, v in vars(self).items() if v is not None and k not in left_out}
        return Conditions(**given, j2=not self.no_j2).sized(R_EARTH + altitude)

    def fields(self, orbit: "ReferenceOrbit | None") -> dict[str, Any]:
        """Epoch and angles, as far as known, as a file's ``reference``; an orbit's are osculating.

        They are none for an orbit without an epoch. InputError for some of the four alone.
        """
        if orbit is not None and self.epoch is None:
            return {}
        place = {"epoch": self.epoch, **{k: getattr(orbit or self, k) for k in ANGLES}}
        known = {name: value for name, value in place.items() if value is not None}
        if known and len(known) < len(place):
            raise InputError(
                f"--{next(iter(known)).removesuffix('_deg').replace('_', '-')} is given, but not "
                "all that says where an orbit is; expected all of --epoch, --inclination, --raan "
                "and --argument-of-latitude, or none of them."
            )
        return known


ErrorPreset = Literal["cold-gas", "calibrated", "uncalibrated", "electric", "none"]
PRESETS = "Preset cold-gas, calibrated, uncalibrated, electric or none"  # too long for a metavar


@dataclass(frozen=True)
class RiskSettings:
    """A chance constraint on separation, and the errors that it is about."""

    asked: float | None = setting(
        "Upper limit on the probability that any pair comes within r_col, with errors.", "--risk"
    )
    navigation_sigma: float | None = setting(
        "With --risk: standard deviation of each component of known positions, m."
    )
    thrust_sigma: float | None = setting(
        "With --risk: standard deviation of each burn's size, as a share of it, and of its "
        "direction about each axis across it, rad."
    )
    velocity_sigma: float | None = setting(
        "Standard deviation of each velocity component, m/s; by default the mean motion times "
        "--navigation-sigma."
    )
    errors: ErrorPreset | None = setting(
        f"Instead of sigmas: errors as of `prolearn fly`, but for missed burns. {PRESETS}.",
        metavar="PRESET",
    )
    closed_loop: bool = setting(
        "Risk with feedback: deviations are corrected at each node from estimated states.",
        "--closed-loop",
        default=False,
    )

    def limit(self) -> "RiskLimit | None":
        """The limit on the risk, if any; InputError where it or the errors are missing."""
        from pipeline.plan.requirements import RiskLimit

        # 0 is given, too.
        given = {k: v for k, v in vars(self).items() if v is not None and v is not False}
        if not given:
            return None
        if self.asked is None:
            raise InputError(
                f"--{next(iter(given)).replace('_', '-')} is given without --risk; expected the "
                "probability that craft may come too close, and their errors, such as --risk 1e-3 "
                "--navigation-sigma 0.2."
            )
        if self.errors is not None:
            from pipeline.flight.errors import PRESETS

            given["errors"] = PRESETS[self.errors]
        return RiskLimit(**given)


@dataclass(frozen=True)
class FlightConditions:
    """Conditions of a flight, by mean elements; None leaves a value to the scenario."""

    eccentricity: float = _condition("Mean, of the reference orbit, up to 0.85.", default=0.001)
    inclination_deg: float | None = _condition(
        "Mean, deg; by default the scenario's, else 97.4.", "--inclination"
    )
    raan_deg: float | None = _condition(
        "Right ascension of its node, deg; the scenario's, else 0.", "--raan"
    )
    argument_of_perigee_deg: float = _condition(
        "Mean, from the ascending node, deg.", "--argument-of-perigee", default=90.0
    )
    argument_of_latitude_deg: float | None = _condition(
        "At the first node, deg; the scenario's, else 0.", "--argument-of-latitude"
    )
    no_j2: bool = _condition("Leave the Earth's oblateness out.", "--no-j2", default=False)
    ballistic: float | None = _condition(
        "Add drag: mean C_D A/m, m²/kg; a CubeSat's is 0.01.", "--drag"
    )
    spread: float | None = _condition(
        "Relative spread of C_D A/m over the swarm: first craft less, last more.  [default: 0.1]",
        "--drag-spread",
    )

    def about(self, scenario: "Scenario") -> "Conditions":
        """Conditions by these options, else by the scenario's reference orbit."""
        from pipeline.flight.world import conditions_of

        _check_drag(self)
        given = {k: v for k, v in vars(self).items() if v is not None and k != "no_j2"}
        return replace(conditions_of(scenario), **given, j2=not self.no_j2)


@dataclass(frozen=True)
class FlownTrials:
    """Settings of a plan that is flown many times with errors."""

    trials: int | None = _trial("Fly so many times, with errors that differ.")
    seed: int = _trial("Root seed of the errors.", default=0)
    errors: ErrorPreset = _trial(
        f"{PRESETS}; --error changes single ones.", default="cold-gas", metavar="PRESET"
    )
    error: list[str] | None = _trial(
        "Change one: magnitude=0.05. Names: position, velocity, position_bias, velocity_bias, "
        "semi_major_axis, navigation_time, latency, magnitude, direction, magnitude_fixed, "
        "direction_fixed, magnitude_bias, direction_bias, impulse_bit, timing, missed, lost.",
        metavar="NAME=VALUE",
    )
    world: Literal["nonlinear", "linear"] = _trial(
        "The conditions above, or the linear model of planners.", default="nonlinear"
    )
    replan: Literal["none", "feedback", "every-node"] = _trial(
        "Compare with craft corrected, or replanned, at every node.", default="none"
    )
    planner: str = _trial(
        "Of replanning, as for `prolearn plan`.", default="expert", autocompletion=planners
    )
    effort: EffortOption | None = _trial("Of the expert in replanning, as for `prolearn plan`.")
    sigmas: float | None = _trial(
        "Margin of replanning, standard deviations of separations beyond r_col; 3 by default."
    )
    size: float = _trial("Centre distance below which two craft may touch, m.", default=0.35)
    device: Literal["auto", "cpu", "cuda"] | None = _trial(
        "Device on which torch computes trials in the linear world; numpy does if not given."
    )
    out: Path | None = _trial("Folder; PLAN-flown by default.")


@dataclass(frozen=True, kw_only=True)
class Planning:
    """Settings of the planner, and of what plans must satisfy."""

    planner: str = setting(
        "expert, refiner, minimum-energy, straight-line, decoupled-optimum, or a model (ff1, ...).",
        default="expert",
        autocompletion=planners,
    )
    separation: SeparationOption = "continuous"
    effort: EffortOption | None = setting(
        "When the expert stops: at the first safe plan, once its plan no longer improves, or "
        "after several searches, with the best. By default the second; after a model the first, "
        "which takes a safe plan of the refiner as it is."
    )
    assignment: Literal["given", "optimal"] = setting(
        "Who takes which goal: as given, or such that the fuel is least.", default="given"
    )
    allow_drift: bool = setting(
        "Accept states that are not energy-matched.", "--allow-drift", default=False
    )


@dataclass(frozen=True, kw_only=True)
class Tradeoff(Planning):
    """Settings of a trade-off of fuel against transfer time."""

    duration: Annotated[str, option("Range of transfer times: 10..60min, 600..3600s.")]
    steps: int = setting("Durations at most, spread over the range.", default=20)
    goal: Literal["fixed", "moving"] = setting(
        "Goals are the states given, whenever they are reached, or slots that move on along "
        "their passive orbits and are there after the scenario's own duration.",
        default="fixed",
    )
    out: Path | None = setting("Folder; SCENARIO-tradeoff by default.")
