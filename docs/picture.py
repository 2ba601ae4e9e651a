"""Draw the README's picture: the paper's Figure 1, right, by the expert and without it.

python docs/picture.py
"""

from pathlib import Path

from pipeline.experiments.examples.figure import figure_transfer
from pipeline.experiments.examples.run import Example
from pipeline.orbit.problem import Problem
from pipeline.orbit.transfer import track
from pipeline.planners.baselines import BASELINES
from pipeline.planners.expert import Expert
from pipeline.scenario import draw

OUT = Path(__file__).parent / "images" / "transfer.png"


def main() -> None:
    """Plan one tilt-split transfer of 10 craft with three planners and draw them."""
    scenario = draw("tilt-split", 0, 10, 2, Problem())
    tracks = {}
    for planner in (*BASELINES[1:], Expert()):
        plan = planner.plan([scenario])[0]
        tracks[planner.name] = track(plan.states, plan.controls, scenario.problem, 12)
    example = Example(
        "A 200 m ring to two rings tilted by ±45°",
        scenario.initial,
        scenario.goal,
        tracks,
        scenario.problem.collision_radius,
    )
    OUT.parent.mkdir(exist_ok=True)
    figure_transfer(example).savefig(OUT, dpi=200)


if __name__ == "__main__":
    main()
