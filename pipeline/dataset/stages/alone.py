"""Whether a file holds sound rows, whatever dataset they are of."""

import pyarrow as pa

from pipeline.dataset.format.schema import (
    SCENARIO_FIELDS,
    SOLVED_FIELDS,
    problem_of,
    scenarios_of,
)
from pipeline.dataset.format.solving import requirements_of
from pipeline.dataset.stages.physics import row_faults
from pipeline.errors import InputError
from pipeline.storage.shards import Size, decode, told_by

ANY = Size(rows=100_000, values=10_000_000)
"""The most that a shard of any dataset may hold."""


def stands_alone(content: bytes) -> bool:
    """Whether bytes are a shard that is sound by all that it says of itself."""
    try:
        table = decode(content, ANY)
        return table.num_rows > 0 and _is_sound(table)
    except (InputError, ValueError):  # what is no shard has no shape either
        return False


def _is_sound(table: pa.Table) -> bool:
    solved = table.schema.equals(pa.schema(SOLVED_FIELDS))
    if not solved and not table.schema.equals(pa.schema(SCENARIO_FIELDS)):
        return False
    sizes = {scenario.n for scenario in scenarios_of(table)}
    if sizes != {*table["n_spacecraft"].to_pylist()} or len(sizes) != 1:
        return False
    faults = row_faults(table, sizes.pop(), problem_of(table), requirements_of(told_by(table)))
    return not (solved and any(faults))
