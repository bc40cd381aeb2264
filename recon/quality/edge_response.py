"""Resolution from an edge response: its width, and the modulation transfer function."""

from itertools import pairwise

import numpy as np
from jaxtyping import Float


def mtf(response: Float[np.ndarray, " bin"], step: float) -> tuple[np.ndarray, np.ndarray]:
    """Compute the modulation transfer function: the spectrum of the derivative of an edge response.

    Parameters
    ----------
    response : edge response at equal steps
    step : distance of two values [mm, or voxel]

    Returns
    -------
    frequencies [1/mm, or 1/voxel], and transfer, 1 at frequency 0

    References
    ----------
    ICRU Report 87, section 4.3: the MTF is the modulus of the Fourier transform of the line spread function, which is
    the derivative of the edge response. A Hann window removes the noise far from the edge.
    """
    line = np.diff(response) * np.hanning(len(response) + 1)[1:-1]
    padded = 8 * len(line)
    transfer = np.abs(np.fft.rfft(line, padded))
    return np.fft.rfftfreq(padded, step), transfer / (transfer[0] or 1.0)


def edge_width(distance: Float[np.ndarray, " bin"], response: Float[np.ndarray, " bin"]) -> float:
    """Compute the distance over which an edge falls from 90 to 10 % of its height.

    Parameters
    ----------
    distance : distances from the surface [mm, or voxel]
    response : edge response, from 1 to 0

    Returns
    -------
    distance [mm, or voxel]; NaN where it does not fall so
    """

    def crossing(level: float) -> float:
        for (a, ya), (b, yb) in pairwise(zip(distance, response, strict=True)):
            if ya >= level > yb:
                return a + (b - a) * (ya - level) / (ya - yb)
        return float("nan")

    return crossing(0.1) - crossing(0.9)
