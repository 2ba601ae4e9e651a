"""Devices of torch by name."""

from functools import lru_cache

import torch

from pipeline.errors import InputError


@lru_cache
def torch_device(name: str) -> torch.device:
    """Torch device by its name, for "auto" CUDA where there is one; InputError if not available."""
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    reason = ""
    try:
        if name.partition(":")[0] in ("cpu", "cuda", "mps"):
            device = torch.device(name)
            torch.zeros(1, device=device)
            return device
    except (RuntimeError, AssertionError) as error:
        first, *_ = str(error).splitlines()[0].split(". ")  # torch goes on for a page
        reason = f" ({first})"
    raise InputError(
        f"device is {name!r}{reason}; expected cpu, or cuda or mps where there is one."
    )
