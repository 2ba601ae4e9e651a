"""Devices of torch by name."""

from functools import lru_cache

import torch

from pipeline.errors import InputError


@lru_cache
def torch_device(name: str) -> torch.device:
    """Torch device by its name, for "auto" CUDA where there is one; InputError if not available."""
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        if device.type not in ("cpu", "cuda", "mps"):
            raise RuntimeError("nothing is computed on such a device")
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(
            f"device is {name!r} ({reason}); expected cpu, or cuda or mps where there is one."
        ) from error
    return device
