"""Fisher scoring: maximum likelihood of a few parameters with damped steps, and what their uncertainty is."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from spectra.errors import InputError

# Steps end where the log likelihood can rise by less than this, or a step has lowered the deviance by less than that
# [no unit]: 0.05 of an uncertainty at most.
_CONVERGED, _LITTLE = 1e-4, 2e-3
_MOST_STEPS = 60
# Damping of the first step relative to the diagonal of the information, its factors, and where it gives up.
_DAMPING, _LESS, _MORE, _LARGEST = 1e-3, 0.2, 8.0, 1e8
# Beyond this condition number of the information, scaled to a unit diagonal, rounding decides.
_SINGULAR = 1e12
# Parameters are said to be hard to separate where one is so many times less certain than if the others were known.
_INFLATED = 10.0
# Entries of the weakest direction, scaled to unit length, that are named.
_NAMED = 0.3

Vector = Float[np.ndarray, " parameter"]
Matrix = Float[np.ndarray, "parameter parameter"]


class Likelihood(NamedTuple):
    """Poisson likelihood of parameters.

    Parameters
    ----------
    deviance : twice the log likelihood ratio to a perfect fit
    score : derivative of the log likelihood
    information : Fisher information, nuisance parameters eliminated
    """

    deviance: float
    score: Vector
    information: Matrix


@dataclass(frozen=True, eq=False)
class Maximum:
    """Parameters of maximum likelihood.

    Parameters
    ----------
    values : of the parameters
    information : of the data alone
    prior_information : diagonal, 1 / variance of each prior; 0 without
    deviance : of the data
    steps : number of steps
    """

    values: Vector
    information: Matrix
    prior_information: Vector
    deviance: float
    steps: int

    @property
    def covariance(self) -> Matrix:
        """Inverse of the information of data and priors; infinite where these do not determine the parameters."""
        return inverse(self.information + np.diag(self.prior_information))

    @property
    def uncertainty(self) -> Vector:
        """Standard deviations."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def alone(self) -> Vector:
        """Standard deviation that each parameter would have if the others were known."""
        with np.errstate(divide="ignore"):
            return 1 / np.sqrt(np.diag(self.information) + self.prior_information)

    def inseparable(self, names: tuple[str, ...], units: tuple[str, ...]) -> str | None:
        """Say in a sentence which parameters the data hardly separate.

        Parameters
        ----------
        names, units : of the parameters

        Returns
        -------
        the sentence; None where data and priors determine all of them well
        """
        information = self.information + np.diag(self.prior_information)
        weak = weakest(information)
        worst = int(np.argmax(np.abs(weak)))
        uncertainty = self.uncertainty[worst]
        if uncertainty <= _INFLATED * self.alone[worst]:
            return None
        named = [name for name, entry in zip(names, weak, strict=True) if abs(entry) >= _NAMED]
        together = f"known within {uncertainty:.2g} {units[worst]}" if np.isfinite(uncertainty) else "unknown"
        return (
            f"the data hardly separate {' and '.join(named)}: {names[worst]} would be known within "
            f"{self.alone[worst]:.2g} {units[worst]} if the others were, and is {together} together with them; "
            "state what is known of one as a prior, or measure behind another material"
        )


def inverse(information: Matrix) -> Matrix:
    """Invert a Fisher information.

    Parameters
    ----------
    information : symmetric, not negative

    Returns
    -------
    covariance; all entries infinite where the information is singular to rounding
    """
    scale = np.sqrt(np.diag(information))
    if not (scale > 0).all():
        return np.full_like(information, np.inf)
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    if values[0] <= values[-1] / _SINGULAR:
        return np.full_like(information, np.inf)
    return (vectors / values) @ vectors.T / np.outer(scale, scale)


def weakest(information: Matrix) -> Vector:
    """Find the direction of the parameters, each in units of what it would be known to alone, that data tell least of.

    Parameters
    ----------
    information : Fisher information

    Returns
    -------
    unit vector; a single entry 1 where the data tell nothing of one parameter
    """
    scale = np.sqrt(np.diag(information))
    if not (scale > 0).all():
        return (np.arange(len(scale)) == np.argmin(scale)) * 1.0
    return np.linalg.eigh(information / np.outer(scale, scale))[1][:, 0]


def maximise(
    evaluate: Callable[[Vector], Likelihood], start: Vector, prior: Vector, low: Vector | None = None
) -> Maximum:
    """Maximise a likelihood times Gaussian priors around the start by Levenberg's damped Fisher scoring.

    Parameters
    ----------
    evaluate : the likelihood; raises `InputError` for impossible parameters, which are then avoided
    start : parameters where the search begins, and the means of the priors
    prior : standard deviation of each prior; infinite for none
    low : lowest value of each parameter; no limits where left out

    Returns
    -------
    the maximum

    Raises
    ------
    InputError
        When the search does not converge.

    References
    ----------
    Osborne 1992, Fisher's method of scoring, doi:10.2307/1403504.
    """
    known = 1 / np.asarray(prior, dtype=np.float64) ** 2
    least = np.full(len(start), -np.inf) if low is None else low
    values = np.asarray(start, dtype=np.float64)
    here, damping = evaluate(values), _DAMPING
    for step in range(_MOST_STEPS):
        score = here.score - known * (values - start)
        information = here.information + np.diag(known)
        diagonal = np.maximum(np.diag(information), 1e-12 * np.diag(information).max())
        free = ~((values <= least) & (score <= 0))
        move = np.zeros(len(values))
        damped = (information + np.diag(damping * diagonal))[np.ix_(free, free)]
        move[free] = np.linalg.solve(damped, score[free])
        if score @ move < _CONVERGED:
            return Maximum(values, here.information, known, here.deviance, step)
        trial = np.maximum(values + move, least)
        there = _tried(evaluate, trial)
        gain = -np.inf if there is None else _cost(here, values, start, known) - _cost(there, trial, start, known)
        if there is not None and gain > 0:
            values, here, damping = trial, there, damping * _LESS
            if gain < _LITTLE:
                return Maximum(values, here.information, known, here.deviance, step)
        elif damping > _LARGEST:
            return Maximum(values, here.information, known, here.deviance, step)
        else:
            damping *= _MORE
    raise InputError(
        f"the calibration did not converge in {_MOST_STEPS} steps: state priors, or leave fewer parameters free"
    )


def _tried(evaluate: Callable[[Vector], Likelihood], values: Vector) -> Likelihood | None:
    """The likelihood; None where values are impossible."""
    try:
        return evaluate(values)
    except InputError:
        return None


def _cost(found: Likelihood, values: Vector, start: Vector, known: Vector) -> float:
    """Deviance of data and priors."""
    return found.deviance + float(known @ (values - start) ** 2)
