"""Requirements that no plan can be made for are refused, and no others."""

from dataclasses import replace

import pytest

from pipeline.errors import InputError
from pipeline.orbit.problem import Problem
from pipeline.orbit.thrust import Thrust
from pipeline.plan.requirements import refuse_risk
from pipeline.scenario import draw


def test_a_risk_with_further_limits_of_thrust_is_refused_in_closed_loop_alone():
    plain = draw("rings", 0, 2, 0, Problem())
    limited = replace(plain, problem=Problem(thrust=Thrust("norm")))
    refuse_risk([limited])
    refuse_risk([plain], closed_loop=True)
    with pytest.raises(InputError, match="leave closed_loop out"):
        refuse_risk([plain, limited], closed_loop=True)
