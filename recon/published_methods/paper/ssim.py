"""Structural similarity that gradients can pass, as R2-Gaussian computes it."""

import torch
from jaxtyping import Float
from torch import Tensor

WINDOW, SIGMA = 11, 1.5
C1, C2 = 0.01**2, 0.03**2  # for images between 0 and 1


def ssim(
    image: Float[Tensor, "view channel row column"], other: Float[Tensor, "view channel row column"]
) -> Float[Tensor, "view channel row column"]:
    """Map of structural similarity: a Gaussian window of 11 x 11 pixels and standard deviation 1.5, zeros outside.

    References
    ----------
    Wang, Bovik, Sheikh, Simoncelli 2004, doi:10.1109/TIP.2003.819861, eq. 13, for a data range of 1.
    """
    stack = torch.cat([image, other, image * image, other * other, image * other], dim=1)
    mean, other_mean, square, other_square, product = _blur(stack).chunk(5, dim=1)
    variance, other_variance = square - mean**2, other_square - other_mean**2
    covariance = product - mean * other_mean
    alike = (2 * mean * other_mean + C1) * (2 * covariance + C2)
    return alike / ((mean**2 + other_mean**2 + C1) * (variance + other_variance + C2))


def _blur(images: Float[Tensor, "view image row column"]) -> Float[Tensor, "view image row column"]:
    """Convolution with the window, first along rows, then along columns."""
    offsets = torch.arange(WINDOW, dtype=images.dtype) - WINDOW // 2
    window = torch.exp(-(offsets**2) / (2 * SIGMA**2))
    window = window / window.sum()
    views, count, rows, columns = images.shape
    flat = images.reshape(views * count, 1, rows, columns)
    flat = torch.nn.functional.conv2d(flat, window.view(1, 1, 1, -1), padding=(0, WINDOW // 2))
    flat = torch.nn.functional.conv2d(flat, window.view(1, 1, -1, 1), padding=(WINDOW // 2, 0))
    return flat.reshape(images.shape)
