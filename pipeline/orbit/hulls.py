"""Facets of convex hulls by Qhull, kept in the user's cache folder for the next process.

Qhull is part of SciPy, whose import takes as long as the rest of a `prolearn plan`.
"""

import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from pipeline.arrays import Array, Float, Int
from pipeline.errors import InputError
from pipeline.files import published

Corners = list[Int[Array, "_ _"]]


def corners(clouds: Sequence[Float[Array, "_ _"]]) -> Corners:
    """Facets of the convex hull of each point cloud, as indices of their vertices.

    QhullError, a RuntimeError, or ValueError where a hull is flat. A file that is missing, damaged
    or of other points is rewritten where that is possible, and else ignored.
    """
    if cold := "scipy.spatial" not in sys.modules:
        with suppress(OSError, EOFError, KeyError, ValueError, BadZipFile, RuntimeError):
            return _kept(clouds)
    from scipy.spatial import ConvexHull

    found = [ConvexHull(points).simplices for points in clouds]
    if cold:
        with (
            suppress(OSError, InputError, RuntimeError),
            published(_file(clouds)) as temporary,
            temporary.open("wb") as file,
        ):
            np.savez(file, *clouds, *found)
    return found


def _file(clouds: Sequence[Float[Array, "_ _"]]) -> Path:
    """Path of one of 256 cache files, which bounds their number; RuntimeError without a home."""
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    digest = sha256(b"".join(points.tobytes() for points in clouds)).hexdigest()
    return folder / "prolearn" / f"hulls-{digest[:2]}.npz"


def _kept(clouds: Sequence[Float[Array, "_ _"]]) -> Corners:
    """The facets cached for these points; ValueError where the file is of other points."""
    with np.load(_file(clouds)) as file:  # which never unpickles
        points, found = (
            [file[f"arr_{k + first}"] for k in range(len(clouds))] for first in (0, len(clouds))
        )
    if not all(map(np.array_equal, points, clouds)):
        raise ValueError("these are other points")
    return found
