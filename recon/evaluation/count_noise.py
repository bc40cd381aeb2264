"""Noise of counts beside their prediction: of the counts, magnified by corrections, and of the flat field."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Real

from phantomgen.dataset.checks.door import find_array
from phantomgen.dataset.file import FLAT
from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.spectral_model import Spectra


@dataclass(frozen=True, eq=False)
class CountNoise:
    """Variance of the difference of measured and expected counts.

    Parameters
    ----------
    spectra : says how a correction for dead time magnifies noise
    flats : relative variance of the mean flat, see `flat_noise`
    """

    spectra: Spectra
    flats: Float[np.ndarray, "channel row column"]

    @classmethod
    def of(cls, dataset: Dataset) -> "CountNoise":
        """Return the noise of a dataset.

        Parameters
        ----------
        dataset : an open dataset

        Returns
        -------
        the noise
        """
        return cls(dataset.spectra, flat_noise(dataset))

    def spread(
        self,
        primary: Real[np.ndarray, "channel row column"],
        scattered: Real[np.ndarray, "channel row column"] | float = 0.0,
    ) -> Float[np.ndarray, "channel row column"]:
        """Compute the variance over the expected counts of one view.

        Parameters
        ----------
        primary : expected counts that are proportional to the flat field, in quanta of the detector
        scattered : expected counts that were estimated without it, likewise

        Returns
        -------
        variance over the sum of both, no unit; that of the counts alone where nothing is expected
        """
        expected = np.asarray(primary, dtype=np.float64) + scattered
        return self.spectra.spread(expected) + primary**2 * self.flats / np.where(expected > 0, expected, np.inf)


def flat_noise(dataset: Dataset) -> Float[np.ndarray, "channel row column"]:
    """Compute the relative variance of the mean flat.

    Expected counts Y are proportional to the mean F of N flats, whose noise therefore adds Y^2 v / (N F) to the
    variance of the difference, with v the variance over the mean of one flat. One flat alone is taken as exact: it may
    be a mean of many, or a stated number of photons.

    Parameters
    ----------
    dataset : an open dataset

    Returns
    -------
    variance over the square of the mean, no unit; 0 in pixels that do not measure, and where the dataset has less than
    two flats or `Dataset.air` in place of them
    """
    frames = None if dataset.air is not None else find_array(dataset.file, FLAT)
    if frames is None or frames.shape[0] < 2:
        return np.zeros(dataset.counts.shape[1:])
    spectra = dataset.spectra
    photons = spectra.events(dataset.flat) / spectra.quantum[:, None, None]
    known = (photons > 0) & ~dataset.mask
    return np.where(known, spectra.spread(photons) / (frames.shape[0] * np.where(known, photons, 1.0)), 0.0)
