"""What all commands have in common: the version, exit statuses, completion."""

import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from cli.app import BAD_INPUT, FAILED, INTERRUPTED, TERMINATED

PAGE = (Path(__file__).parents[2] / "docs/cli.md").read_text(encoding="utf-8")


def test_the_version_is_one_line_with_what_it_runs_on(prolearn):
    done = prolearn("--version")
    system = f"{platform.system()} {platform.machine()}"
    line = f"prolearn {version('prolearn')} (Python {platform.python_version()}, {system})\n"
    assert (done.returncode, done.stdout, done.stderr) == (0, line, "")


def test_the_command_runs_as_a_module_too():
    asked = [sys.executable, "-m", "cli.main", "--version"]
    assert subprocess.check_output(asked, text=True).startswith("prolearn ")


def test_exit_statuses_are_the_same_in_help_documentation_and_code(prolearn):
    (line,) = (one for one in prolearn("--help").stdout.splitlines() if "Exit status" in one)
    told = [int(number) for number in re.findall(r"\d+", line)]
    assert told == [0, FAILED, BAD_INPUT, INTERRUPTED, TERMINATED]
    section = PAGE.partition("## Exit status")[2].partition("\n## ")[0]
    assert [int(k) for k in re.findall(r"^\| (\d+) \|", section, re.MULTILINE)] == told


def test_usage_that_is_wrong_is_status_2(prolearn):
    assert prolearn("verify").returncode == 2
    assert prolearn("--versions").returncode == 2


def test_a_width_of_0_is_one_that_is_not_known(prolearn):
    assert "Missing argument 'scenarios'" in prolearn("plan", COLUMNS="0").stderr
    shown = prolearn("plan", "--help", COLUMNS="0").stdout
    assert shown == prolearn("plan", "--help", COLUMNS="80").stdout


@pytest.mark.skipif(shutil.which("bash") is None, reason="asks bash")
def test_bash_completes_commands_subcommands_and_choices_once_it_is_installed(forked, tmp_path):
    program = tmp_path / "bin/prolearn"
    program.parent.mkdir()
    program.write_text(
        f"#!/bin/sh\nexec {shlex.quote(sys.executable)} -c "
        '"from cli.main import app; app(prog_name=\'prolearn\')" "$@"\n'
    )
    program.chmod(0o755)
    path = f"{program.parent}{os.pathsep}{os.environ['PATH']}"

    def bash(script):
        done = subprocess.run(
            ["bash", "--norc", "-c", f"{script}; true"],  # else bash makes way for a sole command
            env=os.environ | {"HOME": str(tmp_path), "PATH": path},
            capture_output=True,
            text=True,
            timeout=60,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    def completed(*words):
        asked = " ".join(f"'{word}'" for word in words)
        return bash(
            f'. "$HOME/.bashrc"; COMP_WORDS=({asked}); COMP_CWORD={len(words) - 1}; '
            '$(complete -p prolearn | sed "s/.*-F //; s/ .*//") prolearn; echo "${COMPREPLY[@]}"'
        ).split()

    bash("prolearn --install-completion")
    program.write_text(f'#!/bin/sh\nexec {shlex.join(forked.command)} "$@"\n')
    assert completed("prolearn", "tra") == ["tradeoff", "train", "transfer-times"]
    assert completed("prolearn", "dataset", "c") == ["card"]
    assert completed("prolearn", "dataset", "--preset", "") == ["demo", "paper"]
    assert completed("prolearn", "verify", "--j") == ["--jobs", "--json"]
    assert completed("prolearn", "plan", "--planner", "re") == ["refiner"]
    assert completed("prolearn", "train", "--arch", "ff1,lstm") == [
        *("ff1,lstm1", "ff1,lstm2", "ff1,lstmcol")
    ]
    assert completed("prolearn", "sample", "--family", "d") == ["dense"]


@pytest.mark.parametrize(("shell", "between"), [("fish", "\t"), ("powershell", ":::")])
def test_every_line_that_other_shells_complete_from_is_an_option(shell, between):
    asked = {
        "_PROLEARN_COMPLETE": f"complete_{shell}",
        "_TYPER_COMPLETE_ARGS": "prolearn plan --",
        "_TYPER_COMPLETE_FISH_ACTION": "get-args",
        "_TYPER_COMPLETE_WORD_TO_COMPLETE": "--",
    }
    code = "from cli.main import app; app(prog_name='prolearn')"
    told = subprocess.check_output([sys.executable, "-c", code], env=os.environ | asked, text=True)
    assert "--effort" in told
    for line in told.splitlines():
        assert line.startswith("--") and between in line


SWALLOWED = """
import signal, time
from cli.app import Terminated, _sigterm_raises

class Left:
    def __del__(self):  # whatever is raised here, Python reports and goes on
        signal.raise_signal(signal.SIGTERM)

try:
    with _sigterm_raises():
        Left()
        time.sleep(60)
except Terminated:
    print("ended")
"""


def test_a_signal_that_comes_in_a_finalizer_ends_the_run_all_the_same():
    done = subprocess.run(
        [sys.executable, "-c", SWALLOWED], capture_output=True, text=True, timeout=40
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "ended\n", "")


STUCK = """
import signal, threading
from concurrent.futures import ThreadPoolExecutor
import typer
from cli import app

app.EXIT_SECONDS = 0.2
commands, pool = typer.Typer(cls=app.CommandGroup), ThreadPoolExecutor(thread_name_prefix="pool")
commands.callback()(lambda: None)
start = threading.Thread.start

def start_amid_a_signal(thread):
    start(thread)
    if thread.name.startswith("pool"):
        signal.raise_signal(signal.SIGTERM)

@commands.command()
def work():
    threading.Thread.start = start_amid_a_signal
    pool.submit(print, "done")

commands(["work"])
"""


def test_a_thread_that_a_signal_kept_from_being_noted_by_its_pool_does_not_keep_the_process():
    done = subprocess.run([sys.executable, "-c", STUCK], capture_output=True, text=True, timeout=40)
    assert done.returncode == TERMINATED
    assert done.stderr == "prolearn: terminated; what was finished is kept.\n"


def test_where_the_home_takes_no_files_matplotlib_draws_without_a_word(tmp_path):
    """As in a container; its caches stay in a temporary folder of this user."""
    (tmp_path / "home").touch()
    known = {key: os.environ[key] for key in os.environ if not key.startswith(("MPL", "XDG"))}
    given = known | {"HOME": str(tmp_path / "home"), "TMPDIR": str(tmp_path)}
    code = "import cli.main, matplotlib as m; print(m.get_configdir(), m.get_cachedir())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=given)
    place = tmp_path / f"prolearn-matplotlib-{os.getuid()}"
    assert (done.stdout, done.stderr) == (f"{place} {place}\n", "")
    assert place.is_dir()
