"""What Tab completes of options whose values are names."""

from collections.abc import Iterable


def planners(incomplete: str) -> list[str]:
    """Planners that come with the package, and architectures, whose champions plan."""
    from pipeline.planners.named import NAMES

    return _beginning([*NAMES, *architectures("")], incomplete)


def architectures(incomplete: str) -> list[str]:
    """Installed architectures; of several, joined by commas, the last."""
    from pipeline.networks.catalogue import architecture_names

    before, comma, last = incomplete.rpartition(",")
    return [before + comma + name for name in _beginning(architecture_names(), last)]


def families(incomplete: str) -> list[str]:
    """Families of scenarios."""
    from pipeline.scenario.families import FAMILIES

    return _beginning(FAMILIES, incomplete)


def _beginning(names: Iterable[str], start: str) -> list[str]:
    return sorted({name for name in names if name.startswith(start)})
