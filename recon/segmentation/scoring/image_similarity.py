"""Similarity of two RGB images: PSNR, SSIM, and LPIPS where its weights are available."""

from collections.abc import Callable, Iterable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from recon.evaluation.metrics import SSIM_WINDOW, Scores, psnr

Picture = Float[np.ndarray, "row column 3"]


def image_similarity(pairs: Iterable[tuple[Picture, Picture]]) -> Scores:
    """Compute the mean similarity of pairs of images.

    Parameters
    ----------
    pairs : an image and its truth, RGB 0 to 1

    Returns
    -------
    ``psnr`` [dB] with peak 1 over all pixels and colours; ``ssim`` with a Gaussian window of sigma 1.5 and range 1,
    mean of the colours (Wang et al. 2004, doi:10.1109/TIP.2003.819861); ``lpips`` of AlexNet, lower is better (Zhang
    et al. 2018, arXiv:1801.03924). None for what does not exist: a PSNR without error, an SSIM of images smaller
    than its window, LPIPS without its package and weights
    """
    distance = _lpips()
    found: dict[str, list[float | None]] = {"psnr": [], "ssim": [], "lpips": []}
    for image, truth in pairs:
        found["psnr"].append(psnr(1.0, float(np.mean(np.square(image - truth)))))
        found["ssim"].append(_ssim(image, truth))
        found["lpips"].append(None if distance is None else distance(image, truth))
    return {name: _mean(values) for name, values in found.items()}


def _ssim(image: Picture, truth: Picture) -> float | None:
    """Mean structural similarity; None for images smaller than its window."""
    from skimage.metrics import structural_similarity  # noqa: PLC0415 - a third of a second

    if min(truth.shape[:2]) < SSIM_WINDOW:
        return None
    options: Any = {"data_range": 1.0, "gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    mean: Any = structural_similarity(image, truth, channel_axis=2, **options)
    return float(mean)


def _mean(values: list[float | None]) -> float | None:
    """Mean of the known values; None where there is none."""
    known = [v for v in values if v is not None]
    return float(np.mean(known)) if known else None


def _lpips() -> Callable[[Picture, Picture], float] | None:
    """LPIPS of AlexNet; None without its package and weights, as nothing is downloaded."""
    try:
        package = import_module("lpips")  # never required
    except ImportError:
        return None
    import torch  # noqa: PLC0415

    if not list(Path(torch.hub.get_dir(), "checkpoints").glob("alexnet*")):
        return None
    network = package.LPIPS(net="alex", verbose=False)

    def distance(image: Picture, truth: Picture) -> float:
        first, second = (torch.from_numpy(2 * p - 1).permute(2, 0, 1)[None].float() for p in (image, truth))
        with torch.no_grad():
            return float(network(first, second))

    return distance
