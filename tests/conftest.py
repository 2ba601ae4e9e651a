"""What all tests share."""

import os
from collections.abc import Iterator

import pytest
import shapes
from forked import Forked
from hypothesis import settings

# Arrays and networks this small are slower on several threads, above all beside other workers.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
# Eight processes of a server for evaluations of language models, which nobody here asks for.
os.environ.setdefault("MLFLOW_SERVER_ENABLE_JOB_EXECUTION", "false")

shapes.check_once()

# How long an example takes says nothing on a machine that others use as well.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")


@pytest.fixture(scope="session")
def forked() -> Iterator[Forked]:
    """What runs commands and code in processes of their own, without the imports of each."""
    with Forked() as found:
        yield found
