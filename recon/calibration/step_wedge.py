"""Calibration by known absorbers: expected counts behind them, and their likelihood.

The counts of channel c behind step i are Poisson with mean g_c q_ci, q_ci = sum_k w_ck exp(-sum_m mu_m(E_k) t_im), and
w the sensitivities of a `ChannelModel`. The gains g are nuisance parameters with a closed form, g = sum y / sum q, and
are eliminated from the Fisher information.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import xlogy
from scipy.stats import chi2

from recon.calibration.scoring import Likelihood, Matrix, Maximum, Vector, maximise
from spectra.channel_model import ChannelModel, Values, parameter_names
from spectra.errors import InputError
from spectra.materials.material import Material

# Steps of central differences: voltage [kV], filter [mm], thresholds and resolution [keV].
_STEPS = {"voltage": 1.0, "filter": 0.01, "threshold": 0.1, "resolution": 0.1}
UNITS = {"voltage": "kV", "filter": "mm", "threshold": "keV", "resolution": "keV"}
# A model whose deviance is less likely than this does not explain the counts.
_UNLIKELY = 1e-3


@dataclass(frozen=True, eq=False)
class StepWedge:
    """Counts behind known absorbers.

    Parameters
    ----------
    materials : of the absorbers
    lengths : path length in each material behind each step [mm]
    counts : measured, darks subtracted; may be sums over pixels and views
    common_gain : whether all channels have one gain, so that ratios of open-beam counts tell of the spectrum; else each
        channel has its own, as in a scan whose flats are divided out
    """

    materials: tuple[Material, ...]
    lengths: Float[np.ndarray, "step material"]
    counts: Float[np.ndarray, "step channel"]
    common_gain: bool = False

    def __post_init__(self) -> None:
        if self.lengths.shape != (len(self.counts), len(self.materials)):
            raise InputError(
                f"{len(self.counts)} steps and {len(self.materials)} materials need as many lengths, "
                f"got {self.lengths.shape}"
            )
        if not (np.isfinite(self.counts).all() and (self.counts >= 0).all() and self.counts.any(axis=0).all()):
            raise InputError("counts must be finite and not negative, and some of each channel positive")
        if not (np.isfinite(self.lengths).all() and (self.lengths >= 0).all()):
            raise InputError("thicknesses must be finite and not negative [mm]")


@dataclass(frozen=True, eq=False)
class WedgeModel:
    """Likelihood of the free parameters of a `ChannelModel`, given counts behind a step wedge.

    Parameters
    ----------
    model : sensitivities of the channels
    wedge : what was measured
    start : all arguments of the model: start of the search for free ones, means of priors, and values of the others
    free : which of them are estimated
    """

    model: ChannelModel
    wedge: StepWedge
    start: Values
    free: Bool[np.ndarray, " argument"]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(n for n, free in zip(self.all_names, self.free, strict=True) if free)

    @property
    def all_names(self) -> tuple[str, ...]:
        """Names of all arguments of the model."""
        return parameter_names(self.wedge.counts.shape[1])

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the free parameters."""
        return tuple(UNITS[name.partition("_")[0]] for name in self.names)

    def all_values(self, values: Vector) -> Values:
        """Return all arguments of the model.

        Parameters
        ----------
        values : of the free ones

        Returns
        -------
        free and other values
        """
        whole = np.array(self.start, dtype=np.float64)
        whole[self.free] = values
        return whole

    def relative(self, values: Vector) -> Float[np.ndarray, "step channel"]:
        """Compute the counts behind each step at gain 1.

        Parameters
        ----------
        values : of the free parameters

        Returns
        -------
        counts per cm^2 and mAs at 1 m
        """
        return self._passed @ self.model.weights(self.all_values(values)).T

    def expected(self, values: Vector) -> Float[np.ndarray, "step channel"]:
        """Compute the counts behind each step at the gains of maximum likelihood.

        Parameters
        ----------
        values : of the free parameters

        Returns
        -------
        counts
        """
        relative = self.relative(values)
        axis = None if self.wedge.common_gain else 0
        return relative * self.wedge.counts.sum(axis=axis) / relative.sum(axis=axis)

    def likelihood(self, values: Vector) -> Likelihood:
        """Compute the likelihood with the gains eliminated.

        Parameters
        ----------
        values : of the free parameters

        Returns
        -------
        deviance, score and information
        """
        counts, expected = self.wedge.counts, self.expected(values)
        slopes = self._slopes(values)
        deviance = 2 * float((xlogy(counts, counts) - xlogy(counts, expected) - counts + expected).sum())
        score = np.einsum("sc,psc->p", counts - expected, slopes)
        information = np.einsum("sc,psc,qsc->pq", expected, slopes, slopes)
        return Likelihood(deviance, score, information - self._of_gains(expected, slopes))

    def fit(self, prior: Vector) -> Maximum:
        """Estimate the free parameters.

        Parameters
        ----------
        prior : standard deviations of priors around the start; infinite for none

        Returns
        -------
        the estimate

        Raises
        ------
        InputError
            When the search does not converge, or a resolution of 0 is to be estimated.
        """
        if self.free[-1] and not self.start[-1] > 0:
            raise InputError("a resolution that is free needs a start above 0 keV, such as 5")
        low = np.array([0.0 if name == "filter" else -np.inf for name in self.names])
        return maximise(self.likelihood, self.start[self.free], prior, low)

    def misfit(self, found: Maximum) -> str | None:
        """Say in a sentence where the model does not explain the counts.

        Parameters
        ----------
        found : the estimate

        Returns
        -------
        the sentence, or None
        """
        freedom = self.freedom
        if freedom <= 0 or chi2.sf(found.deviance, freedom) > _UNLIKELY:
            return None
        return (
            f"the model does not explain the counts within their noise: the deviance is {found.deviance:.4g} and about "
            f"{freedom} is expected; stated uncertainties are of noise only and too small"
        )

    @property
    def freedom(self) -> int:
        """Counts less parameters that they determine."""
        gains = 1 if self.wedge.common_gain else self.wedge.counts.shape[1]
        return self.wedge.counts.size - gains - int(self.free.sum())

    def _slopes(self, values: Vector) -> Float[np.ndarray, "parameter step channel"]:
        """Derivatives of the log of the counts at constant gain, by central differences."""
        slopes = []
        for i, name in enumerate(self.names):
            step = _STEPS[name.partition("_")[0]]
            up, down = values.copy(), values.copy()
            up[i], down[i] = values[i] + step, max(values[i] - step, 1e-3 if name == "resolution" else -np.inf)
            logs = [np.log(np.maximum(self.relative(v), np.finfo(float).tiny)) for v in (up, down)]
            slopes.append((logs[0] - logs[1]) / (up[i] - down[i]))
        return np.stack(slopes)

    def _of_gains(
        self, expected: Float[np.ndarray, "step channel"], slopes: Float[np.ndarray, "parameter step channel"]
    ) -> Matrix:
        """Information that goes into the gains."""
        axis = (0, 1) if self.wedge.common_gain else (0,)
        mixed = (expected * slopes).sum(axis=tuple(a + 1 for a in axis)).reshape(len(slopes), -1)
        return (mixed / expected.sum(axis=axis).reshape(1, -1)) @ mixed.T

    @cached_property
    def _passed(self) -> Float[np.ndarray, "step energy"]:
        """Part of the photons of each bin that passes each step."""
        mu = np.stack([m.attenuation(self.model.energies.nodes) for m in self.wedge.materials])
        return np.exp(-self.wedge.lengths @ mu)


def with_counts(model: WedgeModel, counts: Float[np.ndarray, "step channel"]) -> WedgeModel:
    """Return the model of other counts behind the same wedge.

    Parameters
    ----------
    model : of some counts
    counts : the other ones

    Returns
    -------
    the model
    """
    return replace(model, wedge=replace(model.wedge, counts=counts))
