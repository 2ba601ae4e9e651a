"""The default transfer with 5 control intervals, for tests that do not depend on the time grid."""

from pipeline.orbit.problem import Problem

PROBLEM = Problem(nodes=6, time_step=240.0)
"""The default duration, 1200 s, in 5 intervals rather than 10: closed loops take half the time."""

OPTIONS = ("--nodes", "6", "--time-step", "240")
"""The same grid as options of ``prolearn sample`` and ``prolearn scenario new``."""
