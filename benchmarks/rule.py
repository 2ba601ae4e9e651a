"""The refiner's rounds without its network: the rule, which shows what is learned."""

from dataclasses import replace

from pipeline.experiments.ablations import RULE
from pipeline.networks.model import Model
from pipeline.networks.refiner.packaged import TrainedRefiner
from pipeline.orbit.problem import Problem
from pipeline.plan import AT_ALL_TIMES, Requirements
from pipeline.planners.network import NetworkPlanner


def rule(rounds: int, requirements: Requirements = AT_ALL_TIMES) -> NetworkPlanner:
    """The untrained refiner: the cheapest safe iterate of so many rounds, or else the last."""
    return NetworkPlanner(TrainedRefiner(None, rounds, Problem(), ""), RULE, requirements)


def with_rounds(model: Model, rounds: int) -> Model:
    """A refiner with the same weights whose answer takes so many rounds."""
    return replace(model, config={**model.config, "rounds": rounds}).on(model.problem)
