"""Memory that is not there is refused, not granted and then taken back by the kernel."""

import subprocess
import sys

import pytest

from cli.app import available
from pipeline.orbit.problem import Problem
from pipeline.plan.document import write_plan
from pipeline.planners.named import named_planner
from pipeline.scenario import draw

ASK = """
import numpy as np
from cli.app import available, within_memory
with within_memory():
    np.empty(int({share} * available()), dtype=np.uint8)
"""


@pytest.mark.skipif(available() is None, reason="the system does not say what is free")
@pytest.mark.parametrize(("share", "refused"), [(0.5, False), (1.1, True)])
def test_more_than_is_free_is_refused_in_a_sentence(share, refused):
    done = subprocess.run(
        [sys.executable, "-c", ASK.format(share=share)], capture_output=True, text=True
    )
    assert (done.returncode != 0) == refused, done.stderr
    assert ("takes more memory than the" in done.stderr) == refused


COMMAND = """
import resource
import pipeline.flight.effects, pipeline.flight.effects, pipeline.plan.document, pipeline.show
from cli.main import app
from cli.app import _listed, Path
used = 1024 * _listed(Path("/proc/self/status"), "VmData:")
resource.setrlimit(resource.RLIMIT_DATA, (used + 32 * 2**20, resource.RLIM_INFINITY))
app({arguments})
"""
"""With 32 MB left, which is enough to read the plan."""


@pytest.fixture(scope="module")
def large(tmp_path_factory):
    """A file with a plan of a thousand craft."""
    path = tmp_path_factory.mktemp("large") / "plan.json"
    (plan,) = named_planner("minimum-energy").plan([draw("rings", 0, 1000, 0, Problem())])
    write_plan(path, plan)
    return path


@pytest.mark.skipif(available() is None, reason="the system does not say what is free")
@pytest.mark.parametrize("command", ["show", "fly"])
def test_a_plan_that_is_too_large_to_look_at_is_refused_in_a_sentence(command, large):
    program = COMMAND.format(arguments=[command, str(large)])
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 1, done.stderr
    assert "this takes more memory than" in done.stderr and "Traceback" not in done.stderr


def test_a_file_for_which_there_is_no_memory_is_refused_in_a_sentence(tmp_path):
    (tmp_path / "s.json").write_bytes(b" " * 100 * 2**20)
    program = COMMAND.format(arguments=["plan", str(tmp_path / "s.json"), "--out", "p.json"])
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (done.returncode, done.stderr.count("\n")) == (1, 1), done.stderr
    assert "this takes more memory than the system gives" in done.stderr
