"""The ramp filter of filtered back-projection, and its windows."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

WINDOWS: dict[str, Callable[[np.ndarray], np.ndarray]] = {  # of frequencies in parts of the cutoff
    "ram-lak": np.ones_like,
    "shepp-logan": lambda part: np.sinc(part / 2),
    "cosine": lambda part: np.cos(np.pi / 2 * part),
    "hann": lambda part: 0.5 + 0.5 * np.cos(np.pi * part),
}


def ramp_filtered(
    images: Float[np.ndarray, "view basis row column"], pitch: float, window: str, cutoff: float
) -> Float[np.ndarray, "view basis row column"]:
    """Apply half the band-limited ramp filter along rows, sampled in space, with zero padding.

    Parameters
    ----------
    images : weighted line integrals [no unit]
    pitch : distance between columns at the isocentre [mm]
    window : one of `WINDOWS`
    cutoff : frequency above which the filter is zero [Nyquist frequencies]

    Returns
    -------
    filtered images [1/mm]

    References
    ----------
    Kak & Slaney 1988, Principles of Computerized Tomographic Imaging, eq. 3.61.
    """
    columns = images.shape[-1]
    size = 1 << (2 * columns - 1).bit_length()
    steps = np.minimum(np.arange(size), size - np.arange(size))
    kernel = np.zeros(size)
    kernel[0] = 1 / (8 * pitch)
    odd = steps % 2 == 1
    kernel[odd] = -1 / (2 * np.pi**2 * pitch * steps[odd] ** 2)
    part = np.arange(size // 2 + 1) / (size / 2) / cutoff
    response = (np.fft.rfft(kernel).real * np.where(part <= 1, WINDOWS[window](part), 0.0)).astype(np.float32)
    return np.stack([np.fft.irfft(np.fft.rfft(view, size) * response, size)[..., :columns] for view in images])
