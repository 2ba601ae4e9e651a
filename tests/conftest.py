"""What all tests share."""

import atexit
import gc
import os
import shutil
import signal
import tempfile
from collections.abc import Generator, Iterator
from functools import cache
from pathlib import Path

import pytest
import shapes
from clusters import Cluster
from forked import Forked
from hypothesis import settings
from jaxtyping import config

# Arrays and networks this small are slower on several threads, above all beside other workers.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
# Eight processes of a server for evaluations of language models, which nobody here asks for.
os.environ.setdefault("MLFLOW_SERVER_ENABLE_JOB_EXECUTION", "false")
# Worker processes, whose imports take long, where a test asks for them and not for one a core.
os.environ.setdefault("LOKY_MAX_CPU_COUNT", "1")

# Where it is set, stdout has no buffer, and nothing is left in it that cannot be written.
os.environ.pop("PYTHONUNBUFFERED", None)

# Files of tests lie in memory where there is room: what is flushed there takes no time.
MEMORY, NEEDED = Path("/dev/shm"), 4e9  # bytes, several times what the tests write
if MEMORY.is_dir() and shutil.disk_usage(MEMORY).free > NEEDED:
    # Pytest has asked for the folder of temporary files before it reads this.
    os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", str(MEMORY))
    os.environ.setdefault("TMPDIR", str(MEMORY))

# Longer turns where processes outnumber cores: each time one is interrupted its caches are cold.
if hasattr(os, "SCHED_BATCH"):  # Linux alone
    os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))

# A worker that has told its results ends at once, after what registers later: to take apart all
# that it has imported takes the interpreter seconds.
if "PYTEST_XDIST_WORKER" in os.environ:
    atexit.register(os._exit, 0)

# A shell has what it starts in the background ignore Ctrl-C, by which tests interrupt commands.
signal.signal(signal.SIGINT, signal.default_int_handler)

shapes.check_once()

LONG = {
    *("test_torture.py", "test_pages.py", "test_json.py", "test_full_disk.py", "test_browser.py"),
    *("test_files.py", "test_kill.py", "test_risk.py", "test_report.py", "test_page.py"),
    *("test_experiments_on_dask.py", "test_montecarlo.py", "test_unfinished.py", "test_contest.py"),
    *("test_export.py", "test_foreign_architecture.py", "test_flights.py", "test_light.py"),
}
"""Files with the longest tests, which come first: one that came last would have a worker alone."""

CHECKED = ("pipeline", "judge", "benchmarks", "test_shapes.py")
"""Where calls of ``pipeline`` are checked by their annotations, but in tests marked ``untyped``."""


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Leave out of garbage collections what was imported: a look through it takes half a second."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(5_000, 20, 100)
        gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_unconfigure() -> None:
    """Collect garbage once and freeze the rest, since pytest then collects many times over.

    At the end the interpreter takes modules apart as usual, or duckdb would complain.
    """
    gc.collect()
    gc.freeze()
    atexit.unregister(gc.freeze)  # of commands
    atexit.register(gc.unfreeze)


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """Have one of two workers collect backwards: each then compiles half of the modules."""
    report = yield
    if isinstance(collector, pytest.Directory) and os.environ.get("PYTEST_XDIST_WORKER") == "gw1":
        report.result.reverse()
    return report


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the files with the longest tests first, and all in the same order in each worker."""
    items.sort(key=lambda item: (item.path.name not in LONG, item.path))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    (place, *_) = item.path.relative_to(Path(__file__).parent).parts
    unchecked = place not in CHECKED or "untyped" in item.keywords
    config.update("jaxtyping_disable", unchecked)


# How long an example takes says nothing on a machine that others use as well.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")


@pytest.fixture(scope="session", autouse=True)
def coarse() -> None:
    """Figures of few pixels, at which no test looks."""
    from pipeline.figures.style import RC

    RC["savefig.dpi"] = 40


@pytest.fixture(scope="session", autouse=True)
def known_commands() -> None:
    """Cache of the command line, all of which Typer makes anew at each invocation in a test."""
    from typer import testing

    vars(testing)["_get_command"] = cache(vars(testing)["_get_command"])


@pytest.fixture(scope="session")
def forked(testrun_uid: str) -> Iterator[Forked]:
    """What runs commands and code in processes of their own, without the imports of each."""
    with Forked(Path(tempfile.gettempdir(), f"forked-{testrun_uid[:12]}")) as found:
        yield found


@pytest.fixture(scope="session")
def migrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which an SQLite file has all of MLflow's tables and nothing in them."""
    import mlflow

    path = tmp_path_factory.mktemp("migrated") / "mlflow.db"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{path}")
        patch.setenv("MLFLOW_DISABLE_TELEMETRY", "true")
        mlflow.MlflowClient(tracking_uri=f"sqlite:///{path}").search_experiments()
    return path


@pytest.fixture(scope="session")
def known_operators() -> None:
    """Cache of the operators of torch's ONNX exporter, which parses all of them for each graph."""
    from torch.onnx._internal.exporter import _registration

    apis = vars(_registration)["onnxscript_apis"]
    apis.get_torchlib_ops = cache(apis.get_torchlib_ops)


@pytest.fixture
def cluster(forked: Forked, tmp_path: Path) -> Iterator[Cluster]:
    """A Dask scheduler without workers yet."""
    found = Cluster(forked, tmp_path / "cluster")
    try:
        yield found
    finally:
        found.end()
