"""Likelihood of the errors of a spectral model from rays through an unknown object.

Each ray has more channels than basis functions. Its line integrals L are nuisance parameters: those of maximum
likelihood are found for any errors theta of the model, and eliminated from the Fisher information,

    I = sum_rays S^T W S - S^T W A (A^T W A)^-1 A^T W S,

with S and A the derivatives of the log counts by theta and L, and W the expected counts. What is left tells how much
the counts say about theta without any knowledge of the object: with as many channels as functions it is 0.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import xlogy

from recon.calibration.perturbation import Perturbation
from recon.calibration.scoring import Likelihood, Vector
from recon.ops.decompose import decompose
from spectra.transmission import Transmission

# Steps of central differences, by unit.
_STEPS = {"kV": 1.0, "mm": 0.02, "keV": 0.25}
# Relative uncertainty of ratios of open-beam counts between channels, where they are used.
AIR_ERROR = 0.01
# Added to the information of line integrals relative to its trace, for rays without photons.
_RIDGE, _LEAST = 1e-9, 1e-12


@dataclass(frozen=True, eq=False)
class RayLikelihood:
    """Counts of rays, and how a spectral model with errors explains them.

    Parameters
    ----------
    perturbation : the spectral model
    counts : measured, darks subtracted; sums over neighbouring pixels lower the bias that noise causes
    air : open-beam counts of the same pixels and views
    level : open-beam counts per channel, whose ratios tell of the spectrum as well; None where channels may have
        different gains
    """

    perturbation: Perturbation
    counts: Float[np.ndarray, "ray channel"]
    air: Float[np.ndarray, "ray channel"]
    level: Float[np.ndarray, " channel"] | None = None

    def likelihood(self, errors: Vector) -> Likelihood:
        """Compute the likelihood with the line integrals eliminated.

        Parameters
        ----------
        errors : true less stated values [kV, mm, keV]

        Returns
        -------
        deviance, score and information
        """
        transmission = self._transmission(errors)
        lengths = decompose(self.counts, self.air / transmission.open_beam, transmission, tolerance=1e-6)[0]
        projection, slopes = transmission.log_projection_and_slopes(lengths)
        expected = self.air * np.exp(-projection)
        by_error = self._by_error(errors, lengths)
        fisher = np.einsum("rc,rcm,rcn->rmn", expected, slopes, slopes)
        ridge = _RIDGE * np.trace(fisher, axis1=1, axis2=2) + _LEAST
        fisher += ridge[:, None, None] * np.eye(fisher.shape[1])
        mixed = np.einsum("rc,rcm,rcp->rmp", expected, slopes, by_error)
        eliminated = by_error - slopes @ np.linalg.solve(fisher, mixed)
        y = self.counts
        deviance = 2 * float((xlogy(y, y) - xlogy(y, expected) - y + expected).sum())
        score = np.einsum("rc,rcp->p", y - expected, eliminated)
        of_rays = Likelihood(deviance, score, np.einsum("rc,rcp,rcq->pq", expected, eliminated, eliminated))
        return of_rays if self.level is None else _sum(of_rays, self._of_air(errors, self.level))

    def _of_air(self, errors: Vector, level: Float[np.ndarray, " channel"]) -> Likelihood:
        """Likelihood of ratios of open-beam counts, whose logs err by `AIR_ERROR`; one gain is eliminated."""
        slopes = []
        for up, down, step in self._around(errors):
            high, low = (self.perturbation.spectra(e).weights.sum(axis=1) for e in (up, down))
            slopes.append(np.log(high / low) / (2 * step))
        derivative = np.stack(slopes, axis=-1)
        derivative = derivative - derivative.mean(axis=0)
        excess = np.log(level / self.perturbation.spectra(errors).weights.sum(axis=1))
        excess, precision = excess - excess.mean(), 1 / AIR_ERROR**2
        return Likelihood(
            precision * float(excess @ excess), precision * derivative.T @ excess, precision * derivative.T @ derivative
        )

    def _around(self, errors: Vector) -> Iterator[tuple[Vector, Vector, float]]:
        """Errors above and below in each parameter, and the distance of either."""
        for i, unit in enumerate(self.perturbation.units):
            step = np.where(np.arange(len(errors)) == i, _STEPS[unit], 0.0)
            yield errors + step, errors - step, _STEPS[unit]

    def _by_error(
        self, errors: Vector, lengths: Float[np.ndarray, "ray basis"]
    ) -> Float[np.ndarray, "ray channel parameter"]:
        """Derivatives of the log counts at constant line integrals and open beam."""
        slopes = []
        for up, down, step in self._around(errors):
            high, low = (self._transmission(e).log_projection(lengths) for e in (up, down))
            slopes.append((low - high) / (2 * step))
        return np.stack(slopes, axis=-1)

    def _transmission(self, errors: Vector) -> Transmission:
        """Spectral model of these errors."""
        spectra = self.perturbation.spectra(errors)
        return Transmission.from_spectrum(spectra.weights, spectra.basis_values, spectra.channels)


def _sum(one: Likelihood, other: Likelihood) -> Likelihood:
    """Likelihood of independent data."""
    return Likelihood(one.deviance + other.deviance, one.score + other.score, one.information + other.information)
