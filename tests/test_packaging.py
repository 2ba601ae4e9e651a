"""What is installed: three import packages of one distribution, and a light command line."""

import importlib.metadata
import subprocess
import sys

import pytest


@pytest.mark.parametrize("package", ["pipeline", "registry", "cli"])
def test_the_import_packages_belong_to_prolearn_alone(package):
    assert set(importlib.metadata.packages_distributions()[package]) == {"prolearn"}


def test_the_console_script_is_the_application():
    scripts = importlib.metadata.entry_points(group="console_scripts", name="prolearn")
    assert [script.value for script in scripts] == ["cli.main:app"]


@pytest.mark.parametrize("command", [[], ["train"], ["evaluate"], ["plan"], ["models", "list"]])
def test_help_imports_no_heavy_package(command):
    code = (
        "import sys\n"
        "from cli.main import app\n"
        f"sys.argv = ['prolearn', *{command}, '--help']\n"
        "try:\n    app()\nexcept SystemExit as end:\n    assert end.code == 0\n"
        "heavy = {'torch', 'mlflow', 'cvxpy', 'clarabel', 'pandas', 'matplotlib', 'scipy'}\n"
        "found = heavy & set(sys.modules)\n"
        "assert not found, found\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "Usage: prolearn" in done.stdout
