"""Tortures a small project and writes what came of it: ``python -m torture --seed 0``."""

import argparse
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from forked import Forked

from torture.bench import Bench
from torture.damage import CUT, DELETED, FLIPPED, SWAPPED, Damage
from torture.interruption import FULL, KILLED, TERMINATED, Interruption
from torture.tally import Tally

MARK = "<!-- made by make torture -->"
"""What stands before and after the table in the page that has it."""


def torture(
    scratch: Path, commands: Forked, seed: int, kills: int, flips: int, store: Path | None = None
) -> Tally:
    """Kill commands and damage files as often as asked, and interrupt in other ways in proportion.

    ``store`` is an empty MLflow store to copy; without it one is made.
    """
    tally = Tally()
    bench = Bench(scratch, commands, store)
    interruption, damage = Interruption(bench, seed, tally), Damage(bench, seed, tally)
    for kind, share in ((KILLED, 1.0), (TERMINATED, 0.3), (FULL, 0.4)):
        interruption.many(kind, round(share * kills))
        print(f"{kind}: {tally.tries(kind)}", file=sys.stderr, flush=True)
    for kind, share in ((FLIPPED, 1.0), (CUT, 0.2), (SWAPPED, 0.1), (DELETED, 0.2)):
        damage.many(kind, round(share * flips))
        print(f"{kind}: {tally.tries(kind)}", file=sys.stderr, flush=True)
    return tally


def main() -> int:
    """Run it by the command line; status 1 where anything ended badly."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--flips", type=int, default=500)
    parser.add_argument("--page", type=Path, help="page whose table is written anew")
    asked = parser.parse_args()
    with TemporaryDirectory(prefix="torture-") as scratch, Forked() as commands:
        tally = torture(Path(scratch), commands, asked.seed, asked.kills, asked.flips)
    table = tally.markdown()
    print(table)
    print("\n".join(tally.stories), file=sys.stderr)
    if asked.page:
        before, _, after = asked.page.read_text(encoding="utf-8").split(MARK)
        asked.page.write_text(f"{before}{MARK}\n\n{table}\n\n{MARK}{after}", encoding="utf-8")
    return int(tally.bad > 0)


if __name__ == "__main__":
    sys.exit(main())
