"""Resolution from an edge response: its width, and the modulation transfer function."""

from itertools import pairwise

import numpy as np
from jaxtyping import Float, Real
from scipy.signal.windows import tukey

from spectra.errors import InputError


def edge_response(
    volume: Real[np.ndarray, "z y x"], distance: Float[np.ndarray, "z y x"], reach: float, step: float
) -> tuple[Float[np.ndarray, " bin"], Float[np.ndarray, " bin"]]:
    """Compute the mean value at each distance from a surface, scaled to 1 inside and 0 outside.

    The values of all voxels near the surface make one curve, so that its step may be smaller than a voxel.

    Parameters
    ----------
    volume : values of the voxels
    distance : of the centres of the voxels from the surface, negative inside [mm]; `numpy.hypot(x, y) - radius` for a
        cylinder
    reach : largest distance of the curve on both sides [mm]; the outer quarters are the levels inside and outside
    step : width of a bin [mm]

    Returns
    -------
    distances of the centres of the bins [mm], and the edge response

    Raises
    ------
    InputError
        When the shapes differ, a length is not positive, a bin has no voxel, or both levels are equal.
    """
    if np.shape(volume) != np.shape(distance):
        raise InputError(f"distances must have the shape of the volume, {np.shape(volume)}, got {np.shape(distance)}")
    if not (0 < step < np.inf and 4 * step <= reach < np.inf):
        raise InputError(f"an edge response needs a positive step and a reach of four steps, got {step!r}, {reach!r}")
    half = int(reach / step)
    edges = step * np.arange(-half, half + 1)
    near = (distance >= edges[0]) & (distance < edges[-1])
    where = np.digitize(distance[near], edges) - 1
    number = np.bincount(where, minlength=2 * half)
    if not number.all():
        raise InputError(
            f"{np.sum(number == 0)} of {2 * half} bins of the edge response have no voxel: use larger steps"
        )
    mean = np.bincount(where, np.asarray(volume, dtype=np.float64)[near], 2 * half) / number
    inside, outside = mean[: half // 4 + 1].mean(), mean[-(half // 4 + 1) :].mean()
    if inside == outside or not np.isfinite([inside, outside]).all():
        raise InputError(f"there is no edge: the mean is {inside:g} inside and {outside:g} outside of the surface")
    return (edges[1:] + edges[:-1]) / 2, (mean - outside) / (inside - outside)


def mtf(
    response: Float[np.ndarray, " bin"], step: float, binned: bool = True
) -> tuple[Float[np.ndarray, " frequency"], Float[np.ndarray, " frequency"]]:
    """Compute the modulation transfer function: the spectrum of the derivative of an edge response.

    Parameters
    ----------
    response : edge response at equal steps
    step : distance of two values [mm, or voxel]
    binned : whether each value is the mean over a step, as those of `edge_response`; False for values at points

    Returns
    -------
    frequencies [1/mm, or 1/voxel], and transfer, 1 at frequency 0

    Raises
    ------
    InputError
        When there are fewer than 4 values, one is not finite, or the step is not positive.

    References
    ----------
    ICRU Report 87, section 4.3: the MTF is the modulus of the Fourier transform of the line spread function, which is
    the derivative of the edge response. A Tukey window, which is flat in the middle half, removes noise far from the
    edge (a Hann window would make the edge seem sharper: by 3 % where the blur is a seventh of the reach). Differences
    over a step multiply the spectrum by sinc(frequency step), and so do means over a step; both are divided out.
    """
    if len(response) < 4 or not np.isfinite(response).all():
        raise InputError(f"an MTF needs an edge response of 4 finite values or more, got {len(response)} values")
    if not 0 < step < np.inf:
        raise InputError(f"the step of an edge response must be positive and finite, got {step!r}")
    line = np.diff(response)
    line = line * tukey(len(line) + 2, 0.5)[1:-1]
    padded = 8 * len(line)
    transfer = np.abs(np.fft.rfft(line, padded))
    frequency = np.fft.rfftfreq(padded, step)
    transfer = transfer / np.sinc(frequency * step) ** (2 if binned else 1)
    return frequency, transfer / (transfer[0] or 1.0)


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
