"""Files damaged at random: bits flipped, ends cut off, files swapped or deleted."""

import json
from collections.abc import Callable
from pathlib import Path
from random import Random

from pipeline.storage import COPY, MANIFEST
from torture.bench import Bench
from torture.project import FLY, READERS, letters, rows_of, untimed
from torture.tally import Outcome, Tally

FLIPPED, CUT, SWAPPED, DELETED = "flipped bit", "truncated file", "swapped files", "deleted file"

DATASET, FLIGHTS, RESULTS, NETWORKS = "a dataset", "flights", "results", "networks"

PATTERNS = {
    DATASET: ("data/**/*.parquet", "data/_manifest*.json", "data/_timings/_manifest.json"),
    FLIGHTS: ("flown/**/*.parquet", "flown/**/_manifest*.json"),
    RESULTS: ("mlruns/**/tables/*.parquet",),
    NETWORKS: ("mlruns/**/network/*",),
}
"""What is damaged, and the files of it."""

SHARES = {DATASET: 0.5, FLIGHTS: 0.2, RESULTS: 0.15, NETWORKS: 0.15}
"""Of all tries."""

AT_ONCE = 5
"""Files that are damaged together where commands name each."""


def flip(path: Path, chance: Random) -> None:
    """Flip one bit."""
    content = bytearray(path.read_bytes())
    content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
    path.write_bytes(content)


def cut(path: Path, chance: Random) -> None:
    """Cut off an end of any length."""
    content = path.read_bytes()
    path.write_bytes(content[: chance.randrange(len(content))])


def delete(path: Path, _: Random) -> None:
    """Delete a file."""
    path.unlink()


DAMAGES: dict[str, Callable[[Path, Random], None]] = {FLIPPED: flip, CUT: cut, DELETED: delete}


class Damage:
    """Tries on copies of the project, and what came of them."""

    def __init__(self, bench: Bench, seed: int, tally: Tally) -> None:
        self._bench, self._chance, self._tally = bench, Random(seed), tally

    def many(self, damage: str, tries: int) -> None:
        """Do one kind of damage so many times, to everything in turn."""
        for what, share in SHARES.items():
            left = round(share * tries)
            while left > 0:
                left -= self._one(damage, what, min(left, AT_ONCE))

    def _one(self, damage: str, what: str, most: int) -> int:
        """Damage one file or some, and see what comes of it; how many tries that was."""
        folder = self._bench.fresh()
        files = [path for pattern in PATTERNS[what] for path in sorted(folder.glob(pattern))]
        tries = min(most, len(files)) if what in (DATASET, FLIGHTS) and damage != SWAPPED else 1
        chosen = self._swapped(files) if damage == SWAPPED else self._chance.sample(files, tries)
        # A manifest and its copy are not damaged together.
        chosen = [p for p in chosen if p.name != COPY or p.with_name(MANIFEST) not in chosen]
        if damage != SWAPPED:
            for path in chosen:
                DAMAGES[damage](path, self._chance)
        names = [path.relative_to(folder).as_posix() for path in chosen]
        outcome, story = {DATASET: self._dataset, FLIGHTS: self._flights}.get(what, self._store)(
            names
        )
        if letters(folder) != letters(self._bench.project):
            outcome, story = Outcome.LOST, "a file of somebody else's"
        tries = 1 if damage == SWAPPED else len(names)
        self._tally.add(damage, what, outcome, f"{', '.join(names)}: {story}", tries)
        return tries

    def _swapped(self, files: list[Path]) -> list[Path]:
        """Two files of one kind that have changed places."""
        one = self._chance.choice(files)
        alike = [path for path in files if path.suffix == one.suffix and path != one]
        if not alike:
            return self._swapped(files)
        other = self._chance.choice(alike)
        first, second = one.read_bytes(), other.read_bytes()
        one.write_bytes(second)
        other.write_bytes(first)
        return [one, other]

    def _dataset(self, names: list[str]) -> tuple[Outcome, str]:
        """Named by verify, file by file, and mended by repair."""
        run, folder = self._bench.run, self._bench.tried
        wanted = rows_of(self._bench.project / "data")
        changed = {name.removeprefix("data/") for name in names if self._differs(name)}
        _, out, err = run("verify", "data", "--jobs", "1", "--json")
        said = [err]
        named = {fault["path"] for fault in json.loads(out)["faults"]} if out else set()
        said.append(run("evaluate", "--data", "data", "--models", "ff1", "--timed", "0")[2])
        mend = ("verify", "data", "--repair", "--jobs", "1")
        said += [run(*mend)[2], run(*mend, "--yes")[2]]
        status, _, err = run("verify", "data", "--jobs", "1")
        for text in (*said, err):
            if "Traceback" in text:
                return Outcome.TRACEBACK, text
        if status or rows_of(folder / "data") != wanted:
            return Outcome.LOST, err
        if changed - named:
            return Outcome.SILENT, f"verify does not name {', '.join(sorted(changed - named))}"
        return (Outcome.MENDED if changed else Outcome.NOTHING), ""

    def _flights(self, names: list[str]) -> tuple[Outcome, str]:
        """Flown again by the same command."""
        wanted = rows_of(self._bench.project / "flown")
        usual, changed = self._bench.usual[FLY], any(map(self._differs, names))
        status, out, err = self._bench.run(*FLY)
        if "Traceback" in err:
            return Outcome.TRACEBACK, err
        if status or rows_of(self._bench.tried / "flown") != wanted:
            return Outcome.LOST, err
        if untimed(out) != usual:
            return Outcome.SILENT, out
        return (Outcome.MENDED if changed else Outcome.NOTHING), ""

    def _store(self, names: list[str]) -> tuple[Outcome, str]:
        """Refused in a sentence by a command that reads it, or read by none."""
        usual, noticed = self._bench.usual, False
        for arguments in READERS:
            status, out, err = self._bench.run(*arguments)
            if "Traceback" in err:
                return Outcome.TRACEBACK, err
            noticed |= "prolearn: " in err
            refused = status and not out and "prolearn: " in err
            if not refused and untimed(out) != usual[arguments]:
                return Outcome.SILENT, " ".join(arguments)
        return (Outcome.NOTICED if noticed else Outcome.NOTHING), ""

    def _differs(self, name: str) -> bool:
        path = self._bench.tried / name
        return not path.exists() or path.read_bytes() != (self._bench.project / name).read_bytes()
