"""Real Dask schedulers and worker processes on loopback, killed and started again."""

import os
import pickle
import shlex
import shutil
import signal
import socket
import subprocess
import threading
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path
from urllib.request import Request, urlopen

import dask
import numpy as np
import pytest
from clusters import Cluster, kill, until
from contents import content
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import NameOID
from moto.server import ThreadedMotoServer
from typer.testing import CliRunner

from cli.main import app
from pipeline.dataset import card
from pipeline.dataset import samples as presets
from pipeline.dataset.card import write_card
from pipeline.dataset.making import sample, solve
from pipeline.dataset.samples import Sample
from pipeline.dataset.verifying import repair, verify
from pipeline.errors import InputError
from pipeline.expert import Settings
from pipeline.expert import solve as solve_one
from pipeline.files import unfinished
from pipeline.flight.errors import COLD_GAS
from pipeline.flight.loops import TrialSettings, flight_loops
from pipeline.flight.montecarlo import fly_all
from pipeline.flight.world import LinearWorld
from pipeline.orbit.problem import Problem
from pipeline.parallel.workers import Workers
from pipeline.progress import Progress
from pipeline.scenario import draw
from pipeline.storage.folder import open_folder
from pipeline.storage.ledger import Ledger
from pipeline.text import public_url

pytestmark = pytest.mark.system

SHARDS = 12
SHARD = "n=5/part-00001.parquet"


class After(Progress):
    """Does something once a third of the shards is done."""

    def __init__(self, does):
        self.does, self.shards, self.said = does, 0, []

    def done(self, rows, note="", *, failed=0):
        self.shards += 1
        if self.shards == SHARDS // 3:
            self.does()

    def say(self, sentence):
        self.said.append(sentence)


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    """A dataset that is solved here, and beside it one that is not."""
    folder = tmp_path_factory.mktemp("dask") / "here"
    samples = {5: Sample(count=8 * SHARDS, shard_rows=8)}
    sample(folder, samples, Problem(), workers=Workers(1))
    shutil.copytree(folder, folder.with_name("unsolved"))
    solve(folder, Settings(), workers=Workers(jobs=1))
    return folder


@pytest.fixture
def here_and_there(here, tmp_path):
    """The same dataset twice, solved here, and to be solved there."""
    return here, Path(shutil.copytree(here.with_name("unsolved"), tmp_path / "there"))


def assert_same(there, here):
    """The same files, but for what a killed worker left unfinished; the next writer removes it."""
    found = content(there)
    assert {name: found[name] for name in found if not unfinished(Path(name))} == content(here)
    solve(there, Settings(), workers=Workers(jobs=1))
    assert content(there) == content(here)


@pytest.mark.parametrize("shared", [False, True])
def test_a_cluster_that_loses_a_worker_gives_the_bytes_of_this_machine(
    cluster, here_and_there, shared
):
    here, there = here_and_there
    cluster.start_workers()
    cluster.await_workers()
    progress = After(lambda: kill(cluster.workers[0]))
    workers = Workers(scheduler=cluster.address, shared=shared, progress=progress)
    solve(there, Settings(), workers=workers)
    assert progress.shards == SHARDS
    assert_same(there, here)
    assert list(verify(there, workers=Workers(1))) == []  # timings are those of the manifest, too


def test_a_scheduler_that_is_killed_and_comes_back_costs_a_sentence_and_no_byte(
    cluster, here_and_there, capfd
):
    here, there = here_and_there
    cluster.start_workers()
    cluster.await_workers()

    def restart():
        kill(cluster.scheduler)
        cluster.start_scheduler_again()
        cluster.start_workers()  # the old ones end with their scheduler

    progress = After(restart)
    workers = Workers(scheduler=cluster.address, shared=True, progress=progress)
    solve(there, Settings(), workers=workers)
    assert progress.shards == SHARDS
    assert_same(there, here)
    assert list(verify(there, workers=Workers(1))) == []
    gone = f"the Dask scheduler at {cluster.address} is gone; waiting up to 300 s for it to come"
    assert progress.said[0].startswith(gone)
    assert sum("is gone" in sentence for sentence in progress.said) == 1
    assert capfd.readouterr().err == ""


def test_a_scheduler_that_does_not_come_back_ends_the_run_with_a_sentence_and_status_1(
    cluster, here_and_there, forked
):
    _, there = here_and_there
    cluster.start_workers(1)
    cluster.await_workers(1)
    cluster.workers[0].send_signal(signal.SIGSTOP)  # so that the run is not done too early
    options = ["--backend", "dask", "--scheduler", cluster.address, "--scheduler-wait", "0.5"]
    command = [*forked.command, "solve", str(there), *options]
    run = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    cluster.await_call()
    kill(cluster.scheduler)
    said, complaints = run.communicate(timeout=60)
    assert (run.returncode, said) == (1, "")
    lines = complaints.splitlines()
    gone = f"prolearn: the Dask scheduler at {cluster.address} is gone"
    assert lines[0].startswith(f"{gone}; waiting up to 0.5 s")
    assert lines[1].startswith(f"{gone} and did not come back within 0.5 s; ")
    assert len(lines) == 2


def test_workers_and_scheduler_may_be_gone_at_once_before_anything_is_done(cluster, tmp_path):
    gate = tmp_path / "gate"

    def double(task, content):
        (tmp_path / f"begun{task}").touch()
        while not gate.exists():
            time.sleep(0.02)
        return task * content

    def lose_all_and_start_again():
        until(lambda: len(list(tmp_path.glob("begun*"))) == 2)
        cluster.kill_workers()
        kill(cluster.scheduler)
        gate.touch()
        cluster.start_scheduler_again()
        until(lambda: any("no workers yet" in sentence for sentence in progress.said))
        cluster.start_workers()

    cluster.start_workers()
    progress = After(None)
    threading.Thread(target=lose_all_and_start_again).start()
    workers, tasks = Workers(scheduler=cluster.address, progress=progress), range(5)
    results = dict(workers.work(double, tasks, lambda _: np.full(1000, 2.0)))
    assert sorted(results) == list(tasks)
    assert all((results[task] == 2.0 * task).all() for task in tasks)
    gone, empty = progress.said
    assert "is gone; waiting up to" in gone
    assert "has no workers yet; start some with `dask worker" in empty


def test_a_cluster_of_one_thread_does_the_work_itself(cluster):
    cluster.start_workers(1)
    done = Workers(scheduler=cluster.address).work(
        lambda task, content: os.getpid(), range(2), lambda task: b""
    )
    assert {pid for _, pid in done} == {cluster.workers[0].pid}


def test_scenarios_are_drawn_rows_verified_and_a_card_written_by_a_cluster(
    cluster, here, tmp_path, monkeypatch
):
    cluster.start_workers(1)
    workers, drawn = Workers(scheduler=cluster.address), tmp_path / "drawn"
    samples = {5: Sample(count=8 * SHARDS, shard_rows=8)}
    sample(drawn, samples, Problem(), workers=workers)
    solve(drawn, Settings(), workers=workers)
    assert content(drawn) == content(here)
    assert list(verify(drawn, workers=workers)) == []
    alone = write_card(drawn, workers=Workers(1))
    monkeypatch.setattr(card, "VALUES_PER_TASK", 8 * 5 * 66 * 5)  # a few shards of eight scenarios
    progress = After(lambda: None)
    with dask.config.set({"distributed.admin.large-graph-warning-threshold": 1000}):
        assert write_card(drawn, workers=workers.with_progress(progress)) == alone
    assert progress.shards == 3, "pieces"
    (drawn / "n=5/part-00007.parquet").write_bytes(b"")
    with pytest.raises(InputError, match=r"n=5/part-00007.* in .*drawn .*digest.*--repair"):
        write_card(drawn, workers=workers)


def test_workers_that_share_a_folder_mend_it_and_the_client_carries_no_shard(
    cluster, here, tmp_path, monkeypatch
):
    there = Path(shutil.copytree(here, tmp_path / "there"))
    damaged = ["_scenarios/n=5/part-00001.parquet", "n=5/part-00000.parquet"]
    whole = (there / damaged[1]).read_bytes()
    for name in damaged:
        (there / name).write_bytes(b"damaged")
    carried, publish = [], Ledger.publish

    def weighed(ledger, *made):
        carried.append(len(pickle.dumps(made)))
        publish(ledger, *made)

    monkeypatch.setattr(Ledger, "publish", weighed)
    monkeypatch.chdir(tmp_path)  # workers are elsewhere, where `there` is no folder
    cluster.start_workers(1)
    workers, progress = Workers(scheduler=cluster.address, shared=True), After(None)
    assert {fault.path for fault in verify("there", workers=workers)} == {*damaged}
    solve("there", Settings(), workers=workers.with_progress(progress))
    assert content(there) == content(here)
    assert [(there / f"_damaged/{name}.1").read_bytes() for name in damaged] == [b"damaged"] * 2
    aside = [f"{name} in {there} is set aside as _damaged/{name}.1." for name in damaged]
    assert [said for said in progress.said if "aside" in said] == aside
    # Digests, and of plans their timings, with which Parquet takes 2 kB.
    assert (len(carried), carried[0] < 500, carried[1] < 3000 < len(whole) / 8) == (2, True, True)
    assert list(there.rglob("*.tmp")) == []


SOLVE = """
from pipeline.dataset.making import solve
from pipeline.expert import Settings
from pipeline.parallel.workers import Workers
solve({folder!r}, Settings(), workers=Workers(scheduler={scheduler!r}, shared=True))
"""


def test_a_client_that_is_killed_while_workers_write_costs_no_byte_and_leaves_nothing(
    cluster, here_and_there, forked, tmp_path
):
    here, there = here_and_there
    cluster.start_workers()
    cluster.await_workers()
    with (tmp_path / "log").open("w") as log:
        code = SOLVE.format(folder=str(there), scheduler=cluster.address)
        client = forked.start(code, Path.cwd(), log)
    until(lambda: list(there.glob("n=5/*.parquet")))
    kill(client)
    solve(there, Settings(), workers=Workers(scheduler=cluster.address, shared=True))
    assert content(there) == content(here)
    assert list(verify(there, workers=Workers(1))) == []
    assert list(there.rglob("*.tmp")) == []


@pytest.mark.skipif(not Path("/proc/self/cwd").exists(), reason="needs a path that differs")
@pytest.mark.parametrize(  # of another folder in each process
    "where", ["/proc/self/cwd/data", "memory://prolearn-test/data?token=hunter2"]
)
def test_workers_that_do_not_reach_the_folder_say_so_and_write_nothing(
    cluster, here, tmp_path, monkeypatch, in_memory, where
):
    unsolved, places = here.with_name("unsolved"), [tmp_path / "worker", tmp_path / "client"]
    for place in places:
        shutil.copytree(unsolved, place / "data")
    monkeypatch.chdir(places[0])
    cluster.start_workers(1)
    monkeypatch.chdir(places[1])
    sample(where, {5: Sample(count=8 * SHARDS, shard_rows=8)}, Problem(), workers=Workers(1))
    told = f"a worker on {socket.gethostname()} does not reach {public_url(where)} (what is there "
    for command in ("solve", "verify"):
        asked = [command, where, "--backend", "dask", "--scheduler", cluster.address, "--shared"]
        done = CliRunner().invoke(app, asked)
        assert (done.exit_code, done.stdout) == (2, "")
        assert told in done.stderr
        assert "Traceback" not in done.stderr
    assert content(places[0] / "data") == content(unsolved)
    assert "hunter2" not in done.stderr + (cluster.folder / "1.log").read_text()
    solve(where, Settings(), workers=Workers(1))
    assert list(verify(where, workers=Workers(1))) == []


def test_trials_are_flown_by_a_cluster_that_loses_a_worker_to_the_same_bytes(cluster, tmp_path):
    scenario = draw("rings", 0, 4, 0, Problem(), "test")
    plan = solve_one(scenario)
    loops = [*flight_loops(plan, COLD_GAS, with_feedback=True)]
    of = TrialSettings(scenario, LinearWorld(scenario.problem.dynamics), COLD_GAS, portion=5)
    fly_all(tmp_path / "here", of, loops, 60, workers=Workers(1))
    cluster.start_workers()
    cluster.await_workers()
    progress = After(lambda: kill(cluster.workers[0]))
    there = Workers(scheduler=cluster.address, progress=progress)
    fly_all(tmp_path / "there", of, loops, 60, workers=there)
    assert progress.shards == 24
    assert content(tmp_path / "there") == content(tmp_path / "here")


def certificates(folder):
    """A certificate authority and a certificate of this machine, as files; Dask's settings."""
    now, day = datetime.now(UTC), timedelta(days=1)
    keys = [ec.generate_private_key(ec.SECP256R1()) for _ in range(2)]
    names = [x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, k)]) for k in ("ours", "machine")]
    paths = [folder / "ca.pem", folder / "machine.pem"]
    for k, path in enumerate(paths):
        made = (
            x509.CertificateBuilder(names[0], names[k], keys[k].public_key())
            .serial_number(k + 1)
            .not_valid_before(now - day)
            .not_valid_after(now + day)
            .add_extension(x509.BasicConstraints(ca=k == 0, path_length=None), critical=True)
            .sign(keys[0], hashes.SHA256())
        )
        path.write_bytes(made.public_bytes(Encoding.PEM))
    plain = Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()
    (folder / "machine.key").write_bytes(keys[1].private_bytes(*plain))
    comm = "DASK_DISTRIBUTED__COMM__"
    files = {
        f"{comm}TLS__{who}__{what.upper()}": str(folder / f"machine.{suffix}")
        for who in ("SCHEDULER", "WORKER", "CLIENT")
        for what, suffix in (("cert", "pem"), ("key", "key"))
    }
    return files | {f"{comm}TLS__CA_FILE": str(paths[0]), f"{comm}REQUIRE_ENCRYPTION": "true"}


IMPATIENT = """
from cli.main import app
from pipeline.parallel import cluster
cluster.CONNECT_SECONDS = 1.0
app()
"""
"""``prolearn`` that gives up connecting to a Dask scheduler after 1 s."""


def test_a_cluster_with_certificates_works_and_refuses_who_has_none(
    here_and_there, forked, tmp_path, monkeypatch
):
    here, there = here_and_there
    without = dict(os.environ)
    for name, value in certificates(tmp_path).items():
        monkeypatch.setenv(name, value)
    cluster = Cluster(forked, tmp_path / "secure", "tls")
    try:
        cluster.start_workers()
        until(cluster.connected)
        asked = ["solve", str(there), "--backend", "dask", "--scheduler"]
        plain = cluster.address.replace("tls", "tcp")
        for address, status, told in (
            (cluster.address, 2, "Dask has no certificates for it; expected"),
            (plain, 1, "no Dask scheduler answers"),
        ):
            refused = forked.run([*asked, address], tmp_path, without, code=IMPATIENT)
            assert (refused.returncode, "Traceback" in refused.stderr) == (status, False)
            assert told in refused.stderr
        done = forked.run([*asked, cluster.address], tmp_path, os.environ)
        assert done.returncode == 0, done.stderr
    finally:
        cluster.end()
    assert content(there) == content(here)


@pytest.fixture
def bucket(monkeypatch):
    """An S3 server on this machine, where AWS's tools find it, and a bucket there."""
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    keys = {"ACCESS_KEY_ID": "key", "SECRET_ACCESS_KEY": "secret", "DEFAULT_REGION": "us-east-1"}
    for name, value in {**keys, "ENDPOINT_URL": f"http://{host}:{port}"}.items():
        monkeypatch.setenv(f"AWS_{name}", value)
    urlopen(Request(f"http://{host}:{port}/data", method="PUT")).close()
    yield "data"
    server.stop()


def test_keys_of_a_bucket_that_arrow_cannot_open_are_left_alone(bucket, tmp_path):
    here = tmp_path / "here"
    sample(here, {5: Sample(count=4, shard_rows=2)}, Problem(), workers=Workers(1))
    solve(here, Settings(), workers=Workers(1))
    folder, keys = open_folder(f"s3://{bucket}/d"), ("n=5//notes", "/notes", "n=5/notes")
    for name in open_folder(here).names():
        folder.publish(name, (here / name).read_bytes())
    before = folder.names()
    folder.publish(SHARD, b"damaged")
    for key in keys:
        url = f"{os.environ['AWS_ENDPOINT_URL']}/{bucket}/d/{key}"
        urlopen(Request(url, data=b"mine", method="PUT")).close()
    found = repair(folder, workers=Workers(jobs=1))
    assert {fault.path for fault in found} == {SHARD, "n=5/notes"}
    assert list(verify(folder, workers=Workers(jobs=1))) == []
    aside = {f"_damaged/{SHARD}.1", "_foreign/n=5/notes.1"}
    assert {*folder.names()} == {*before, *aside}


def test_the_commands_for_a_cluster_in_the_documentation_make_a_dataset_in_a_bucket(
    cluster, bucket, tmp_path, monkeypatch
):
    page = (Path(__file__).parents[3] / "docs" / "dataset.md").read_text(encoding="utf-8")
    block = page.partition("## On a cluster\n\n```\n")[2].partition("```")[0]
    here = {"tcp://HOST:8786": cluster.address, "--nworkers -1": "--nworkers 2", "BUCKET": bucket}
    for written, meant in here.items():
        assert written in block
        block = block.replace(written, meant)
    scheduler, worker, make = (shlex.split(line, comments=True) for line in block.splitlines())
    assert scheduler == ["dask", "scheduler"]  # as the one that runs
    assert worker[:2] == ["dask", "worker"]
    # Forked from what has imported everything, as all else here, not started by an interpreter.
    monkeypatch.setenv("DASK_DISTRIBUTED__WORKER__MULTIPROCESSING_METHOD", "fork")
    cluster.start("dask_worker", *worker[2:], "--local-directory", str(tmp_path / "scratch"))
    cluster.await_workers(2)
    tiny = {2: Sample(count=5, shard_rows=2), 3: Sample(count=2)}  # what `paper` means here
    monkeypatch.setitem(presets.PRESETS, "paper", tiny)
    done = CliRunner().invoke(app, make[1:])
    assert (done.exit_code, done.stdout) == (
        0,
        f"s3://{bucket}/paper is solved (7 now, 0 without a plan).\n",
    )
    sample(tmp_path / "here", tiny, Problem(), workers=Workers(1))
    solve(tmp_path / "here", Settings(), workers=Workers(1))
    there = open_folder(f"s3://{bucket}/paper")
    shards = [name for name in content(tmp_path / "here") if name.endswith(".parquet")]
    assert len(shards) == 8
    for name in shards:
        assert there.read(name) == (tmp_path / "here" / name).read_bytes()
    assert list(verify(there, workers=Workers(scheduler=cluster.address, shared=True))) == []
