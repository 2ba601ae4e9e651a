"""Outcomes of the rules by which a scenario is checked."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Case:
    """A violation of a rule."""

    craft: tuple[int, ...]  # numbers of those concerned
    text: str  # what is wrong, and by how much
    numbers: Mapping[str, float] = field(default_factory=dict)  # those in the text, SI units


@dataclass(frozen=True)
class Diagnostic:
    """Outcome of a rule at one end, or for the transfer.

    Attributes:
        rule: what was checked.
        end: "initial", "goal" or "transfer".
        text: what was found, in words.
        cases: violations, worst first, each with craft, text and numbers.
        cure: what to do about them.
    """

    rule: str
    end: str
    text: str
    cases: tuple[Case, ...] = ()
    cure: str = ""

    @property
    def fine(self) -> bool:
        """Whether nothing is wrong."""
        return not self.cases

    def __str__(self) -> str:
        lines = [f"{self.end}, {self.rule}: {'fine' if self.fine else 'WRONG'}: {self.text}"]
        lines += [f"    {case.text}" for case in self.cases]
        return "\n".join(lines + [f"    to mend it, {self.cure}"] * bool(self.cure))


def diagnostic_of(
    rule: str, end: str, cases: Sequence[Case], wrong: str, cure: str, fine: str
) -> Diagnostic:
    """The outcome of a rule from its faults: ``wrong`` and ``cure`` or, without any, ``fine``."""
    if not cases:
        return Diagnostic(rule, end, fine)
    return Diagnostic(rule, end, f"{wrong}: {len(cases)}", tuple(cases), cure)
