"""What a dataset was begun with: the same settings and versions go on with it, others are refused.

All that decides the bytes of a dataset is in its manifest, and so in each shard's ``about``.
"""

from pipeline.dataset.format.manifest import Manifest
from pipeline.provenance import DecidedBy, made_with, refuse_other_versions

SAMPLED_BY: DecidedBy = ("pipeline/orbit", "pipeline/scenario"), ("numpy", "scipy", "pyarrow")
"""Code of ours and packages that the bytes of scenarios depend on."""

PLANNING = ("orbit", "scenario", "plan", "expert")
"""Packages of ours that decide a plan to the last bit."""


SOLVED_BY: DecidedBy = (
    tuple(f"pipeline/{part}" for part in PLANNING),
    ("numpy", "scipy", "pyarrow", "clarabel", "highspy"),
)
"""Code of ours and packages that the bytes of plans depend on."""


def refuse_versions(what: object, manifest: Manifest) -> None:
    """Refuse to go on with a dataset that other versions have begun.

    Raises:
        InputError: naming the first version that differs.
    """
    made = manifest.made_with
    refuse_other_versions(f"{what} was sampled", made.sample, made_with(*SAMPLED_BY))
    if manifest.solve:
        versions = made_with(*SOLVED_BY)
        refuse_other_versions(f"{what} was solved", made.solve, versions)
