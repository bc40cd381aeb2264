"""LPIPS, where its package and the weights of its network are installed; nothing is downloaded."""

from collections.abc import Callable
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from jaxtyping import Float

SMALLEST = 64  # pixels along an axis; the network halves images five times
WEIGHTS = "alexnet-owt-7be5be79.pth"  # of torchvision, in torch's folder of checkpoints
Lpips = Callable[[np.ndarray, np.ndarray], float | None]


def missing() -> str | None:
    """Return the reason why LPIPS cannot be computed.

    Returns
    -------
    one sentence; None where it can be computed
    """
    for package in ("lpips", "torchvision"):
        if find_spec(package) is None:
            return f"LPIPS needs the package {package}: pip install 'spectral-ct[lpips]'"
    weights = _checkpoints() / WEIGHTS
    return None if weights.is_file() else f"LPIPS needs the weights {WEIGHTS} of torchvision in {weights.parent.name}"


@cache
def perceptual_distance() -> Lpips | None:
    """Return a function that computes LPIPS of two images in 0..1, with AlexNet, version 0.1.

    Returns
    -------
    function of an image and its truth, (row, column), that gives None for small images; None where packages or weights
    are missing

    References
    ----------
    R. Zhang, P. Isola, A. A. Efros, E. Shechtman, O. Wang, The Unreasonable Effectiveness of Deep Features as a
    Perceptual Metric, CVPR 2018, doi:10.1109/CVPR.2018.00068
    """
    if missing() is not None:
        return None
    import torch  # noqa: PLC0415

    network = import_module("lpips").LPIPS(net="alex", verbose=False).eval()

    def distance(image: Float[np.ndarray, "row column"], truth: Float[np.ndarray, "row column"]) -> float | None:
        if min(image.shape) < SMALLEST:
            return None
        pair = (
            torch.from_numpy(np.clip(a, 0, 1).astype(np.float32) * 2 - 1).expand(1, 3, -1, -1) for a in (image, truth)
        )
        with torch.no_grad():
            return float(network(*pair))

    return distance


def _checkpoints() -> Path:
    from torch.hub import get_dir  # noqa: PLC0415

    return Path(get_dir()) / "checkpoints"
