"""Likelihood: how well line integrals explain counts, with gradient and information, in one pass over the rays."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from recon.ops.arguments import EnergyNodes
from recon.ops.likelihood import cpu
from spectra.errors import InputError
from spectra.threads import run_parallel
from spectra.transmission import Transmission

BLOCK = 64  # rays that go through the energy nodes together
LEAST = 1e-12  # counts; fewer expected counts of a channel have no gradient, as in `recon.ops.deviance.deviance`


class MeasuredCounts(NamedTuple):
    """Counts of some views, as `recon.data.measurements.Measurements` keeps them.

    Parameters
    ----------
    counts : measured counts
    gains : open-beam counts of each pixel over those of the transmission; 0 where a channel of a pixel is not used
    exposure : tube output of each view and channel relative to the flat frames; 0 where a view was not taken
    profile : line integrals of a bowtie filter and of the heel effect for each pixel; None where there are none
    statistical_weights : weight of each count in the likelihood; None where all weights are 1. A negative one
        says that at least that part of the count arrived, see `recon.ops.deviance.at_bounds`
    """

    counts: Float[np.ndarray, "view channel row column"]
    gains: Float[np.ndarray, "channel row column"]
    exposure: Float[np.ndarray, "view channel"]
    profile: Float[np.ndarray, "part row column"] | None = None
    statistical_weights: Float[np.ndarray, "view channel row column"] | None = None


class Likelihood(NamedTuple):
    """Deviance of counts and its derivatives in the line integrals, each count times its share.

    Parameters
    ----------
    deviances : sum of `recon.ops.deviance.deviance` over each view
    gradient : derivative of half the deviance in the line integrals
    curvatures : (J / Y)^T diag(M / (1 + dispersion^2 M)) (J / Y) of each ray, with J the derivatives of the expected
        counts Y and M the larger of y and Y; upper triangle row by row; None where not requested
    residual_curvatures : what the residuals of counts below the expected ones add to these: the sum over channels of
        the second derivatives of Y times the derivative of half the deviance in Y, where that is positive; as
        curvatures
    """

    deviances: Float[np.ndarray, " view"]
    gradient: Float[np.ndarray, "basis view row column"]
    curvatures: Float[np.ndarray, "pair view row column"] | None
    residual_curvatures: Float[np.ndarray, "pair view row column"] | None


def likelihood(
    lengths: Float[np.ndarray, "basis view row column"],
    measured: MeasuredCounts,
    transmission: Transmission,
    dispersion: float,
    information: bool = False,
) -> Likelihood:
    """Compute the deviance of each view, the gradient of half of it, and the curvatures of the rays.

    The variance of counts Y is Y + (dispersion Y)^2. A channel whose gain or exposure is 0 contributes nothing.
    Curvatures are Fisher matrices where the counts are the expected ones. Where more counts arrive, as behind metal
    that is too thick in the model, the curvatures are those of the measured counts, so that steps by their inverse stay
    bounded. Where fewer arrive, the second derivatives of the expected counts add to the curvature of the deviance:
    little where a channel sees nearly one energy, many times the Fisher matrix in the direction that broad spectra
    hardly tell apart.

    Parameters
    ----------
    lengths : line integrals of every basis [no unit]
    measured : counts and what they depend on besides the line integrals
    transmission : columns are the bases, and after them the parts of the profile
    dispersion : relative model error; 0 for Poisson counts
    information : whether to compute curvatures

    Returns
    -------
    deviances, gradient and both curvatures

    Raises
    ------
    InputError
        When line integrals, counts and columns do not belong together.
    """
    views, channels, rows, columns = measured.counts.shape
    parts = 0 if measured.profile is None else len(measured.profile)
    bases, pixels = len(transmission.columns) - parts, rows * columns
    if lengths.shape != (bases, views, rows, columns):
        expected = (bases, views, rows, columns)
        raise InputError(f"line integrals must be (basis, view, row, column), {expected}, got {lengths.shape}")
    rays = cpu.Rays(
        flat(lengths, bases, views, pixels),
        flat(measured.profile, parts, pixels),
        flat(measured.counts, views, channels, pixels),
        flat(measured.statistical_weights, 0 if measured.statistical_weights is None else views, channels, pixels),
        flat(measured.gains, channels, pixels),
        np.ascontiguousarray(measured.exposure, np.float64),
    )
    nodes = EnergyNodes(transmission.columns, transmission.weights, transmission.starts)
    gradient = np.empty((bases, views, pixels), np.float32)
    pairs = bases * (bases + 1) // 2 if information else 0
    fisher, residual = (np.empty((pairs, views, pixels), np.float32) for _ in range(2))

    def one_view(v: int) -> float:
        room = np.empty((3 + bases, BLOCK))
        return cpu.likelihood(rays, v, nodes, float(dispersion), LEAST, room, (gradient, fisher, residual))

    deviances = np.array(list(run_parallel(one_view, range(views))), dtype=np.float64)
    shape = (views, rows, columns)
    curvatures = [part.reshape(-1, *shape) if information else None for part in (fisher, residual)]
    return Likelihood(deviances, gradient.reshape(bases, *shape), *curvatures)


def flat(values: Float[np.ndarray, "..."] | None, *shape: int) -> Float[np.ndarray, "..."]:
    """Convert to contiguous float32 with one axis for all pixels.

    Parameters
    ----------
    values : any array; None for an empty one
    *shape : of the result

    Returns
    -------
    the values; zeros for None
    """
    if values is None:
        return np.zeros(shape, np.float32)
    return np.ascontiguousarray(values, np.float32).reshape(shape)
