"""Numba's just-in-time compilation, with its cache on disk where some folder can be written."""

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numba
from numba.core import config

from pipeline.scratch import own_folder


def _kept() -> bool:
    """Whether numba has a cache folder that can be written, if need be a temporary one.

    In a container, neither the package's folder nor the home may be writable.
    """
    for _ in range(2):
        with suppress(RuntimeError):
            # Path raises where there is no home; numba would make a folder ~ in the current one.
            if config.CACHE_DIR or os.environ.get("XDG_CACHE_HOME") or Path.home():
                numba.njit(cache=True)(lambda: None)
                return True
        with suppress(OSError):
            config.CACHE_DIR = own_folder("numba")
    return False


KEPT = _kept()


def njit(*, cache: bool = True, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """``numba.njit``, without its cache where there is no folder for that."""
    decorator: Callable[[Callable[..., Any]], Any] = numba.njit(cache=cache and KEPT, **options)
    return decorator
