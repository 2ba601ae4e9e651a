"""Where a network is trained."""

import torch

from pipeline.errors import InputError

KINDS = ("cpu", "cuda", "mps")


def training_device(name: str) -> torch.device:
    """The device of a name; "auto" is CUDA where there is one, else the CPU.

    Raises:
        InputError: for a name that means nothing or a device that is not there.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        if device.type not in KINDS:
            raise RuntimeError("nothing is trained on such a device")
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(
            f"device is {name!r} ({reason}); expected auto, or one of {', '.join(KINDS)} that "
            "this machine has."
        ) from error
    return device
