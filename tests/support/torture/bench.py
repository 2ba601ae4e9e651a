"""Fresh copies of the project, and commands run in them."""

import shutil
from collections.abc import Callable
from pathlib import Path

from forked import Forked

from torture.project import FLY, READERS, environment, make, untimed


class Bench:
    """The project, a copy of it, and commands in that.

    A tracking store keeps absolute paths, so the project is made where its copies will be.

    Attributes:
        project: the undisturbed project.
        tried: the copy that is tried.
        usual: what commands that read say of the undisturbed project.
    """

    def __init__(self, scratch: Path, commands: Forked, store: Path | None) -> None:
        self.project, self.tried = scratch / "project", scratch / "tried"
        self._commands = commands
        make(self.tried, commands, store)
        self.tried.rename(self.project)
        self.fresh()
        self.usual = {arguments: untimed(self.run(*arguments)[1]) for arguments in (FLY, *READERS)}
        assert all(self.usual.values())

    def fresh(self) -> Path:
        """A fresh copy of the project in place of the one before."""
        shutil.rmtree(self.tried, ignore_errors=True)
        return Path(shutil.copytree(self.project, self.tried))

    def run(
        self, *arguments: str, meanwhile: Callable[[int], object] = lambda process: None
    ) -> tuple[int, str, str]:
        """Exit status, output and complaints of a command in the copy."""
        done = self._commands.run([*arguments], self.tried, environment(), meanwhile)
        return done.returncode, done.stdout, done.stderr
