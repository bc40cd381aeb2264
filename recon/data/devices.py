"""Where a fit computes: the processor, or a GPU."""

from importlib.util import find_spec

import torch

from spectra.errors import InputError


def device_named(name: str) -> torch.device:
    """The device of that name; of several GPUs the current one.

    Raises
    ------
    InputError
        When there is none, or what computes on it is not installed.
    """
    if name == "cuda" and not torch.cuda.is_available():
        raise InputError("--device cuda needs a GPU and a PyTorch that was built for it; this machine shows none")
    if name == "cuda" and find_spec("triton") is None:
        raise InputError("--device cuda needs the package triton, which is not installed: pip install triton")
    return torch.device(name)
