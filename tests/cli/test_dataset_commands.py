"""sample, solve, dataset and verify as a person runs them, interruptions included."""

import os
import shlex
import shutil
import signal
import time
from pathlib import Path

import pytest
from clusters import kill
from contents import content
from forked import LEAD
from processes import workers_of
from typer.testing import CliRunner

from cli.main import app
from pipeline.dataset import verifying
from pipeline.dataset.verifying import verify
from pipeline.parallel.workers import Workers

DASK = ["--backend", "dask", "--scheduler", "tcp://127.0.0.1:1"]


def run(*arguments):
    """Exit status, output and complaints of a command, run in this process."""
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.stdout, result.stderr


@pytest.fixture
def sampled(tmp_path):
    folder = tmp_path / "data"
    status, said, _ = run("sample", "--n", 2, "--count", 6, "--out", folder, "--jobs", 1)
    assert status == 0
    assert f"prolearn solve {folder}" in said
    return folder


def test_sample_solve_verify_say_what_they_did(sampled):
    status, said, progress = run("solve", sampled, "--jobs", 1)
    assert (status, said) == (0, f"{sampled} is solved (6 now, 0 without a plan).\n")
    assert "solving: 6/6" in progress
    assert "0.0% failed" in progress
    assert run("solve", sampled, "--jobs", 1)[:2] == (
        0,
        f"{sampled} is solved (0 now, 0 without a plan).\n",
    )
    status, said, _ = run("verify", sampled, "--jobs", 1)
    assert (status, said) == (0, f"{sampled} is sound: 6 rows.\n")


def test_what_is_one_is_said_in_the_singular(tmp_path):
    folder = tmp_path / "data"
    _, said, _ = run("sample", "--n", 2, "--count", 1, "--out", folder, "--jobs", 1)
    assert said == f"1 scenario of n=2 is in {folder}; solve it: prolearn solve {folder}\n"
    (folder / "_scenarios/n=2/part-00000.parquet").unlink()
    _, _, progress = run("solve", folder, "--jobs", 1)
    assert "Scenario shards that are missing or damaged are drawn again: 1." in progress


def test_verify_names_file_and_fault_and_repairs_when_asked(sampled):
    run("solve", sampled, "--jobs", 1)
    before = content(sampled)
    shard = sampled / "n=2/part-00000.parquet"
    shard.write_bytes(shard.read_bytes()[:-9])
    status, _, complaints = run("verify", sampled, "--jobs", 1)
    assert status == 1
    assert "n=2/part-00000.parquet: cannot be read" in complaints
    assert f"1 fault in {sampled}; mend it: prolearn verify {sampled} --repair" in complaints
    status, said, _ = run("verify", sampled, "--jobs", 1, "--repair")
    assert (status, said) == (0, f"{sampled} is mended: 1 fault.\n")
    assert content(sampled) == before


@pytest.mark.parametrize("repair", [[], ["--repair"]])
def test_faults_are_told_in_the_order_of_files_whichever_workers_find_first(
    repair, tmp_path, monkeypatch
):
    run("sample", "--n", 2, "--count", 3, "--rows-per-shard", 1, "--out", tmp_path, "--jobs", 1)
    for path in tmp_path.glob("_scenarios/*/*"):
        path.unlink()
    monkeypatch.setattr(verifying, "verify", lambda *a, **how: reversed([*verify(*a, **how)]))
    _, _, complaints = run("verify", tmp_path, "--jobs", 1, *repair)
    told = [line for line in complaints.splitlines() if line.endswith(": is missing")]
    assert told == [f"_scenarios/n=2/part-0000{k}.parquet: is missing" for k in range(3)]


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["solve", "nowhere"], "nowhere does not exist"),
        (["verify", "nowhere"], "nowhere does not exist"),
        (["solve", "DATA", "--jobs", "0"], "jobs is 0"),
        (["solve", "DATA", "--backend", "dask"], "--scheduler tcp://HOST:8786"),
        (["solve", "DATA", "--scheduler-wait", "60"], "expected it with --backend dask"),
        (["solve", "DATA", "--scheduler", "tcp://h:1"], "--scheduler is given and work on this"),
        (["solve", "DATA", "--shared"], "--shared is given and work on this machine has no sched"),
        (["solve", "DATA", *DASK, "--jobs", "2"], "--jobs is given beside --backend dask"),
        (["dataset", "--backend", "loky", "--scheduler", "tcp://h:1"], "it with --backend dask"),
        (["solve", "DATA", *DASK, "--scheduler-wait", "-1"], "scheduler is -1; expected a number"),
        (
            ["solve", "DATA", *DASK, "--scheduler-wait", "nan"],
            "scheduler is nan; expected a number",
        ),
        (["solve", "odd://x"], "no known filesystem"),
        (["sample", "--out", "DATA", "--n", "2", "--count", "7"], "count = 6, now it is 7"),
        (["sample", "--out", "DATA", "--count", "0"], "count is 0"),
        (["sample", "--out", "DATA", "--shares", "1,2"], "--shares is '1,2'"),
        (["sample", "--out", "DATA", "--family", "cubes"], "'cubes'"),
        (["sample", "--out", "DATA", "--altitude", "-1"], "--altitude is -1"),
        (["sample", "--out", "DATA", "--altitude", "6e5"], "mean_motion"),
        (["sample", "--out", "DATA", "--orbit", "{"], "--orbit is not JSON"),
        (["sample", "--out", "DATA", "--orbit", "\udcff"], "--orbit is not JSON"),
        (["sample", "--out", "DATA", "--orbit", "8e6"], "--orbit: input should be an object"),
        (
            ["sample", "--out", "DATA", "--orbit", '{"semi_major_axis":8e6,"semi_major_axis":9e6}'],
            "--orbit: semi_major_axis is there twice",
        ),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_bad_input_is_one_sentence_and_status_2(sampled, monkeypatch, arguments, word):
    monkeypatch.delenv("DASK_SCHEDULER_ADDRESS", raising=False)
    before = content(sampled)
    status, said, complaint = run(*(str(sampled) if a == "DATA" else a for a in arguments))
    assert (status, said) == (2, "")
    assert word in complaint
    assert complaint.startswith("prolearn: ")
    assert complaint.count("\n") == 1
    assert content(sampled) == before


def test_changed_separation_is_refused_with_both_values(sampled):
    run("solve", sampled, "--jobs", 1)
    status, _, complaint = run("solve", sampled, "--jobs", 1, "--separation", "nodes")
    assert status == 2
    assert "separation = continuous, now it is nodes" in complaint


def test_a_folder_that_cannot_be_written_to_is_status_1_and_a_file_in_its_place_2(tmp_path):
    status, _, complaint = run("sample", "--n", 2, "--out", "/proc/nowhere")
    assert status == 1
    assert "/proc/nowhere cannot be written to (No such file or directory); give" in complaint
    (tmp_path / "a file").write_text("")
    status, _, complaint = run("sample", "--n", 2, "--out", tmp_path / "a file" / "data")
    assert status == 2
    assert "a file is a file; expected a folder" in complaint


@pytest.mark.parametrize("name", ["my swarms", "-swarms", "--shared"])
def test_a_command_that_is_said_can_be_pasted(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    status, said, _ = run("sample", "--n", 2, "--count", 1, f"--out={name}")
    assert status == 0
    (_, said) = said.split(": prolearn ")
    assert run(*shlex.split(said))[0] == 0


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """A folder with a few seconds of work, in small shards."""
    from pipeline.dataset.making import sample
    from pipeline.dataset.samples import Sample
    from pipeline.orbit.problem import Problem

    folder = tmp_path_factory.mktemp("drawn") / "long"
    sample(folder, {6: Sample(count=240, shard_rows=2)}, Problem(), workers=Workers(1))
    return folder


@pytest.fixture
def long_work(drawn, tmp_path):
    """A copy of that."""
    return Path(shutil.copytree(drawn, tmp_path / "long"))


@pytest.fixture
def start(forked, long_work, tmp_path):
    """Start solving that, leading a group of processes; ends with the test."""
    started = []

    def command(*options):
        with (tmp_path / "said").open("w") as said:
            process = forked.start(LEAD, tmp_path, said, ["solve", str(long_work), *options])
        started.append(process)
        return process

    yield command
    for process in started:
        kill(process)


@pytest.fixture
def begun(start, long_work, tmp_path):
    """Start solving that and wait until some shards are finished."""

    def command(*options):
        process, end = start(*options), time.monotonic() + 40
        while len(list(long_work.glob("n=6/*.parquet"))) < 4 and time.monotonic() < end:
            assert process.runs(), (tmp_path / "said").read_text()
            time.sleep(0.005)
        return process

    return command


CTRL_C = signal.SIGINT, 130, "interrupted"
SIGTERM = signal.SIGTERM, 143, "terminated"


def alive(group):
    """Whether any process of a group is left."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.system
@pytest.mark.parametrize(
    ("to_all", "jobs", "number", "status", "word"),
    [
        (True, "2", *CTRL_C),
        (True, "1", *CTRL_C),
        (True, "2", *SIGTERM),
        (False, "2", *SIGTERM),
        (False, "1", *SIGTERM),
    ],
)
def test_ctrl_c_and_sigterm_stop_at_once_and_keep_what_is_finished(
    begun, long_work, tmp_path, to_all, jobs, number, status, word
):
    process = begun("--jobs", jobs)
    (os.killpg if to_all else os.kill)(process.pid, number)
    done = len(list(long_work.glob("n=6/*.parquet")))
    ended = process.wait()
    # Counted in work, not in seconds, of which a busy machine takes any number.
    assert len(list(long_work.glob("n=6/*.parquet"))) < done + 20
    complaints = (tmp_path / "said").read_text()
    assert ended == status
    assert complaints.splitlines()[-1] == f"prolearn: {word}; what was finished is kept."
    assert "Traceback" not in complaints
    from pipeline.dataset.verifying import verify

    faults = list(verify(long_work, workers=Workers(jobs=1)))
    kinds = {fault.what.split(";")[0] for fault in faults}
    assert "is missing" in kinds
    # A shard may have been published and its digest not yet; the next run takes it as it is.
    assert kinds <= {"is missing", "is not in the manifest"}
    assert sum(fault.what != "is missing" for fault in faults) <= 1
    assert not list(long_work.rglob("*.tmp"))


@pytest.mark.system
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for workers in /proc")
@pytest.mark.parametrize("wait", [0.2, 0.5])  # s: they are importing
def test_ctrl_c_while_workers_are_starting_shows_no_traceback(start, tmp_path, wait):
    process = start("--jobs", "2")
    end = time.monotonic() + 40
    while len(workers_of(process.pid)) < 2 and time.monotonic() < end:
        time.sleep(0.005)
    time.sleep(wait)
    os.killpg(process.pid, signal.SIGINT)
    assert process.wait() == 130
    complaints = (tmp_path / "said").read_text()
    assert complaints.splitlines()[-1] == "prolearn: interrupted; what was finished is kept."
    assert "Traceback" not in complaints


@pytest.mark.system
def test_after_kill_9_of_the_main_process_its_workers_end_and_the_next_run_completes(
    begun, long_work, forked, tmp_path
):
    process = begun("--jobs", "2")
    kept = content(long_work)
    process.kill()
    assert process.wait() == -signal.SIGKILL
    end = time.monotonic() + 60
    while alive(process.pid) and time.monotonic() < end:
        time.sleep(0.02)
    assert not alive(process.pid)
    done = len(list(long_work.glob("n=6/*.parquet")))
    assert 4 <= done < 120
    status = forked.run(["solve", str(long_work), "--jobs", "1"], tmp_path)
    assert status.returncode == 0, status.stderr
    assert f"({240 - 2 * done} now" in status.stdout
    after = content(long_work)
    shards = {name: digest for name, digest in kept.items() if name.endswith(".parquet")}
    assert shards.items() <= after.items()


def test_a_second_run_names_the_first_and_stops(begun, long_work):
    process = begun("--jobs", "1")
    status, _, complaint = run("solve", long_work, "--jobs", 1)
    assert status == 2
    assert f"is being written by process {process.pid} on " in complaint
