"""Memory that is not there is refused, not granted and then taken back by the kernel."""

import subprocess
import sys

import pytest

from cli.memory import available

ASK = """
import numpy as np
from cli.memory import available, within_memory
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
