"""Blur of the detector: a Gaussian point spread beside the pixel's own aperture.

Model: the modulation transfer function of the spread is MTF(f) = exp(-2 pi^2 sigma^2 f^2), given by its value at one
frequency or by the full width at half maximum of the point spread, FWHM = 2 sqrt(2 ln 2) sigma. Counters register
photons displaced, so that expected counts are blurred and noise stays independent from pixel to pixel. In detectors
that integrate energy the light of each photon spreads, so that signals are blurred with their noise, whose power
spectrum then falls as MTF^2 (Cunningham & Shaw 1999, doi:10.1364/JOSAA.16.000621). Beyond the panel lies its mirror
image: no signal is lost, and an even beam stays even.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import correlate1d
from scipy.optimize import brentq

from phantomgen.geometry.panel import Panel
from spectra.errors import InputError

_REACH = 5  # standard deviations at which the kernel ends
_NARROWEST = 0.05  # of the sampled function [pixel]: its neighbours then get less than 1e-86

_WIDEST = 10_000  # standard deviation [pixel]; no panel has as many pixels along an axis

Kernel = Float[np.ndarray, " _tap"]


@dataclass(frozen=True)
class Blur:
    """Gaussian point spread of the detector.

    Parameters
    ----------
    sigma : standard deviation along each axis [mm]

    Raises
    ------
    InputError
        When the width is not positive and finite.
    """

    sigma: float

    def __post_init__(self) -> None:
        if not 0 < self.sigma < np.inf:
            raise InputError(f"the width of a blur must be positive and finite, got {self.sigma:g} mm")

    @classmethod
    def of_mtf(cls, mtf: float, frequency: float) -> "Blur":
        """Create the blur with the given MTF at one frequency.

        Parameters
        ----------
        mtf : modulation transfer, between 0 and 1
        frequency : spatial frequency [1/mm]

        Returns
        -------
        the blur

        Raises
        ------
        InputError
            When the MTF is not between 0 and 1, or the frequency is not positive.
        """
        if not (0 < mtf < 1 and 0 < frequency < np.inf):
            raise InputError(
                f"an MTF between 0 and 1 at a positive frequency is needed, got {mtf:g} at {frequency:g} /mm"
            )
        return cls(float(np.sqrt(-np.log(mtf) / 2) / (np.pi * frequency)))

    @classmethod
    def of_fwhm(cls, fwhm: float) -> "Blur":
        """Create the blur with the given full width at half maximum.

        Parameters
        ----------
        fwhm : full width at half maximum [mm]

        Returns
        -------
        the blur
        """
        return cls(fwhm / (2 * np.sqrt(2 * np.log(2))))

    def mtf(self, frequency: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Compute the modulation transfer function.

        Parameters
        ----------
        frequency : spatial frequencies [1/mm]

        Returns
        -------
        modulation transfer, 0 to 1
        """
        return np.exp(-2 * (np.pi * self.sigma * frequency) ** 2)

    def kernels(self, panel: Panel) -> tuple[Kernel, Kernel]:
        """Compute the weights of neighbouring pixels along a column and along a row.

        Parameters
        ----------
        panel : the pixel grid

        Returns
        -------
        both kernels

        Raises
        ------
        InputError
            When the blur is wider than `_WIDEST` pixels.
        """
        widest = self.sigma / min(panel.row_pitch, panel.column_pitch)
        if widest > _WIDEST:
            found = f"{self.sigma:g} mm = {widest:g} pixels"
            raise InputError(f"the standard deviation of a blur must be at most {_WIDEST} pixels, got {found}")
        return sampled_gaussian(self.sigma / panel.row_pitch), sampled_gaussian(self.sigma / panel.column_pitch)


def sampled_gaussian(sigma: float) -> Kernel:
    """Compute weights exp(-k^2 / 2 s^2) that sum to one, with s such that their standard deviation is `sigma`.

    Samples of a function much narrower than a pixel would blur less than they should, and their integrals over pixels
    more: the wanted second moment keeps the MTF right at low frequencies, and weights stay positive. From 0.7 pixels
    on s and `sigma` differ by less than 1 %.

    Parameters
    ----------
    sigma : standard deviation [pixel]

    Returns
    -------
    weights of pixels -n to n
    """
    steps = np.arange(-int(np.ceil(_REACH * sigma)) - 1, int(np.ceil(_REACH * sigma)) + 2)

    def excess(width: float) -> float:
        weights = np.exp(-((steps / width) ** 2) / 2)
        return float((steps**2 * weights).sum() / weights.sum() - sigma**2)

    if excess(_NARROWEST) >= 0:
        return np.array([0.0, 1.0, 0.0])
    width = float(brentq(excess, _NARROWEST, 1.5 * sigma + 1.0))  # type: ignore[arg-type]
    weights = np.exp(-((steps / width) ** 2) / 2)
    return weights / weights.sum()


def blurred(image: Float[np.ndarray, "row column"], kernels: tuple[Kernel, Kernel]) -> Float[np.ndarray, "row column"]:
    """Spread an image over neighbouring pixels; its sum does not change.

    Parameters
    ----------
    image : values, (row, column)
    kernels : along columns and along rows

    Returns
    -------
    blurred image, (row, column)
    """
    along_columns, along_rows = kernels
    half = correlate1d(np.asarray(image, dtype=np.float64), along_columns, axis=0, mode="reflect")
    return correlate1d(half, along_rows, axis=1, mode="reflect")
