"""A dataset behind a URL with a password and a token: used by every command, shown by none."""

import shutil
from pathlib import Path

import fsspec
import pytest
from fsspec.implementations.memory import MemoryFileSystem
from short_transfer import OPTIONS
from typer.testing import CliRunner

from cli.main import app
from pipeline.errors import InputError


class KeptFileSystem(MemoryFileSystem):
    """Files in this process's memory, by a scheme that commands do not know."""

    protocol = "kept"

    @classmethod
    def _strip_protocol(cls, path):
        return super()._strip_protocol(path.removeprefix("kept://"))


SECRETS = ("pa55word", "t0k3n", "fr4gment")
URL = "kept://robot:pa55word@box/my n4?token=t0k3n#fr4gment"


@pytest.fixture
def here(tmp_path, migrated, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copyfile(migrated, "mlflow.db")
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    monkeypatch.setenv("COLUMNS", "200")
    fsspec.register_implementation("kept", KeptFileSystem, clobber=True)
    yield tmp_path
    files = fsspec.filesystem("memory")
    for path in files.ls("/", detail=False):
        files.rm(path, recursive=True)


@pytest.fixture
def run(here, capfd):
    """Run a command in this process, where the memory is; status and all that it said."""

    def command(*arguments, status=0):
        result = CliRunner().invoke(app, [str(a) for a in arguments])
        written = capfd.readouterr()
        said = result.stdout + result.stderr + written.out + written.err
        assert result.exit_code == status, said
        assert "Traceback" not in said
        for secret in SECRETS:
            assert secret not in said
        return said

    return command


def kept(folder: Path) -> list[str]:
    """Files below a folder with a secret in their content or name."""
    return [
        f"{path}: {secret}"
        for path in sorted(folder.rglob("*"))
        for secret in SECRETS
        if secret in str(path) or (path.is_file() and secret.encode() in path.read_bytes())
    ]


def test_no_command_shows_or_records_the_secrets_of_a_dataset_s_url(run, here):
    assert "kept://box/my n4 does not exist" in run("solve", URL, status=2)
    few = ("--count", 24, *OPTIONS)
    said = run("sample", "--n", 4, *few, "--out", URL, "--jobs", 1)
    assert "24 scenarios of n=4 are in kept://box/my n4; solve them" in said
    assert "not solved at n=4" in run("train", "--arch", "ff1", "--data", URL, "--n", 4, status=2)
    assert "kept://box/my n4 is solved (24 now" in run("solve", URL, "--jobs", 1)
    assert "kept://box/my n4 is sound" in run("verify", URL, "--jobs", 1)

    training = ("train", "--arch", "ff1", "--data", URL, "--n", 4, "--epochs", 1)
    run(*training)
    assert "Trained before" in run(*training, "--resume")
    evaluate = ("evaluate", "--data", URL, "--trials", 1, "--timed", 0, "--jobs", 1)
    run(*evaluate)
    assert "Evaluated before" in run(*evaluate, "--resume")
    run("warmstart", "--data", URL, "--n", 4, "--trials", 1)
    run("transfer-times", "--data", URL, "--n", 4, "--nodes", "6", "--trials", 1, "--jobs", 1)
    run("flights", "--data", URL, "--n", 4, "--trials", 1, "--flights", 1, "--jobs", 1)
    run("report", "--out", "report")
    assert "kept://box/my n4" in run("models", "show", "ff1")
    run("models", "list")

    assert (here / "mlflow.db").exists() and (here / "mlruns").is_dir()
    assert "kept://box/my n4" in (here / "report" / "report.md").read_text()
    assert kept(here) == []


def test_where_no_model_fits_the_data_these_are_named_without_the_secrets(run):
    for where, *more in ((URL,), ("other", "--nodes", 9)):
        run("sample", "--n", 2, "--count", 24, "--out", where, "--jobs", 1, *more)
        run("solve", where, "--jobs", 1)
    run("train", "--arch", "ff1", "--data", "other", "--n", 2, "--epochs", 1)
    for command in ("evaluate", "flights", "transfer-times", "warmstart"):
        said = run(command, "--data", URL, "--n", 2, status=2)
        assert "no model was trained on kept://box/my n4 as it is now" in said
    said = run("evaluate", "--data", URL, "--models", "ff1", status=2)
    assert "kept://box/my n4 has nodes 11" in said


@pytest.mark.parametrize("form", [("--data", URL), (f"--data={URL}",)])
def test_no_message_of_ours_shows_the_secrets_of_a_url_that_was_typed(run, monkeypatch, form):
    """Whatever a part of the program says of what it was given."""

    def careless(*_, **__):
        raise InputError(f"{URL} is odd; expected another.")

    monkeypatch.setattr("cli.jobs.experiments.evaluate", careless)
    assert "is odd; expected another" in run("evaluate", *form, status=2)


@pytest.mark.parametrize(
    "form", [("verify", "other", URL), ("solve", "none", "--separation", URL), (URL,)]
)
def test_an_error_of_usage_shows_no_secrets(run, form):
    assert "kept://box/my n4" in run(*form, status=2)


def test_a_damaged_shard_is_named_without_the_secrets(run):
    run("sample", "--n", 2, "--count", 6, "--out", URL, "--jobs", 1)
    run("solve", URL, "--jobs", 1)
    files = fsspec.filesystem("memory")
    (shard,) = [p for p in files.glob("/**/n=2/part-00000.parquet") if "/_" not in p]
    files.pipe(shard, files.cat(shard)[:-50])
    said = run("train", "--arch", "ff1", "--data", URL, "--n", 2, status=2)
    assert "part-00000.parquet in kept://box/my n4 does not have the digest" in said
    assert "1 fault in kept://box/my n4" in run("verify", URL, "--jobs", 1, status=1)


def test_a_search_takes_a_url_and_records_none_of_its_secrets(run, here):
    pytest.importorskip("optuna")
    run("sample", "--n", 3, "--count", 12, "--shares", ".5,.5,0", "--out", URL, "--jobs", 1)
    run("solve", URL, "--jobs", 1)
    said = run("tune", "--arch", "ff1", "--data", URL, "--n", 3, "--trials", 1, "--epochs", 1)
    assert "--data 'kept://box/my n4'" in said
    assert kept(here) == []


def test_the_network_of_a_store_that_failed_keeps_no_secret(run, here, monkeypatch):
    run("sample", "--n", 3, "--count", 12, "--shares", ".5,.5,0", "--out", URL, "--jobs", 1)
    run("solve", URL, "--jobs", 1)

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("registry.training._log_model", full)
    said = run("train", "--arch", "ff1", "--data", URL, "--n", 3, "--epochs", 1, status=1)
    assert "is kept in" in said
    (story,) = here.glob("unregistered/*/training.json")
    assert '"dataset": "kept://box/my n4"' in story.read_text()
    assert kept(here) == []


@pytest.mark.usefixtures("known_operators")
def test_a_model_card_has_none_even_of_a_run_that_was_recorded_with_them(run, here):
    pytest.importorskip("onnxscript")
    run("sample", "--n", 3, "--count", 12, "--shares", ".5,.5,0", "--out", URL, "--jobs", 1)
    run("solve", URL, "--jobs", 1)
    run("train", "--arch", "ff1", "--data", URL, "--n", 3, "--epochs", 1)
    import sqlite3

    with sqlite3.connect(here / "mlflow.db") as database:
        database.execute("UPDATE params SET value = ? WHERE key = 'dataset'", (URL,))
    run("models", "export", "ff1", "--out", "ff1.onnx")
    run("models", "show", "ff1")
    assert "`kept://box/my n4`" in (here / "ff1.onnx.md").read_text()
    for path in here.glob("ff1.onnx*"):
        assert not any(secret.encode() in path.read_bytes() for secret in SECRETS)


@pytest.mark.parametrize(
    ("uri", "status", "words"),
    [
        ("http://robot:pa55word@127.0.0.1:1/?token=t0k3n", 1, "http://127.0.0.1:1/ does not"),
        ("http://robot:pa55/word@127.0.0.1:1", 1, "http://... does not answer"),
        ("postgresql://robot:pa55word@127.0.0.1:1/runs?sslkey=t0k3n", 1, "1:1/runs failed"),
        ("nowhere://robot:pa55word@127.0.0.1/?token=t0k3n", 1, "nowhere://127.0.0.1/ failed"),
        ("file://robot:pa55word@host/mlruns?token=t0k3n", 2, "'file://host/mlruns'"),
        ("postgresql://robot:pa55word@127.0.0.1:port/runs", 2, "1:port/runs', which cannot"),
        ("robot:pa55word@127.0.0.1:5000", 2, "'127.0.0.1:5000'"),
        ("sqlite://?password=pa55word", 2, "expected a file"),
    ],
)
def test_a_tracking_store_that_cannot_be_used_is_named_without_its_secrets(
    uri, status, words, run, monkeypatch
):
    monkeypatch.setenv("MLFLOW_TRACKING_URI", uri)
    assert words in run("models", "list", status=status)


@pytest.mark.parametrize(
    ("url", "status", "words"),
    [
        ("ftp://robot:pa55word@127.0.0.1:1/n4", 1, "ftp://127.0.0.1:1/n4 is not reached"),
        ("ftp://robot:pa55/word@127.0.0.1:1/n4", 2, "ftp://... is on no known filesystem"),
        ("nowhere://robot:pa55word@host/n4?t=t0k3n", 2, "nowhere://host/n4 is on no known"),
        ("file://robot:pa55word@host/n4", 2, "file://host/n4 is not on this machine"),
        ("file:///n4?token=t0k3n", 2, "file:///n4 goes on with ?"),
    ],
)
def test_a_dataset_that_is_not_reached_is_named_without_its_secrets(url, status, words, run):
    assert words in run("verify", url, "--jobs", 1, status=status)


@pytest.mark.parametrize("scheme", ["tcp://", ""])
def test_a_scheduler_that_does_not_answer_is_named_without_its_secrets(scheme, run):
    pytest.importorskip("distributed")
    run("sample", "--n", 2, "--count", 2, "--out", URL, "--jobs", 1)
    address = f"{scheme}robot:pa55word@127.0.0.1:1"
    said = run("solve", URL, "--backend", "dask", "--scheduler", address, status=1)
    assert f"answers at {scheme}127.0.0.1:1" in said
