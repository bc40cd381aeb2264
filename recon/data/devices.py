"""The device on which a fit computes: the processor, or a GPU."""

from importlib.util import find_spec

import torch

from spectra.errors import InputError

DEVICES = "cpu", "cuda"


def device_named(name: str) -> torch.device:
    """Find the device of a name; of several GPUs the current one.

    Parameters
    ----------
    name : ``cpu`` or ``cuda``

    Returns
    -------
    the device

    Raises
    ------
    InputError
        When there is no such device, no GPU, or its compiler is not installed.
    """
    if name not in DEVICES:
        raise InputError(f"device must be {' or '.join(DEVICES)}, got {name!r}")
    if name == "cuda" and not torch.cuda.is_available():
        raise InputError("--device cuda needs a GPU and a PyTorch that was built for it; this machine shows none")
    if name == "cuda" and find_spec("triton") is None:
        raise InputError("--device cuda needs the package triton, which is not installed: pip install triton")
    return torch.device(name)
