"""The data term of a fit: deviance of counts with its gradient, chi-square, and what both are with noise alone.

It takes one pass over the rays; the same by tensors, for a GPU, is in `recon.gaussians.likelihood`.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Float64

from recon.ops.arguments import EnergyNodes
from recon.ops.deviance import poisson_means
from recon.ops.likelihood import BLOCK, LEAST, MeasuredCounts, cpu, flat
from spectra.threads import run_parallel
from spectra.transmission import Transmission

RAYS_PER_PIECE = 128 * BLOCK  # of a view; changes time, and the last digits of sums


class DataTerm(NamedTuple):
    """Data term of some views, without units; the sums are over views and pixels.

    Parameters
    ----------
    gradient : derivative of half the deviance in the line integrals
    deviances : of all counts, each times its statistical weight
    noise_deviances : the same for a true model, which noise alone separates from the counts
    chi_squares : of the pixels that measure, without statistical weights
    noise_chi_squares : the same for a true model
    """

    gradient: Float32[np.ndarray, "view basis row column"]
    deviances: Float64[np.ndarray, " channel"]
    noise_deviances: Float64[np.ndarray, " channel"]
    chi_squares: Float64[np.ndarray, " channel"]
    noise_chi_squares: Float64[np.ndarray, " channel"]


def data_term(
    lengths: Float[np.ndarray, "view basis row column"],
    measured: MeasuredCounts,
    transmission: Transmission,
    dispersion: float,
) -> DataTerm:
    """Compute the data term of some views; any number of threads gives the same bits.

    Parameters
    ----------
    lengths : line integrals of every basis [no unit]
    measured : counts and what they depend on besides the line integrals
    transmission : columns are the bases, and after them the parts of the profile
    dispersion : relative model error; the variance of counts Y is Y + (dispersion Y)^2

    Returns
    -------
    sums of each channel, NaN where a line integral is, as in a fit that diverges; and the gradient of each ray
    """
    views, bases, rows, columns = lengths.shape
    channels, pixels = len(transmission), rows * columns
    rays = [_rays_of_view(lengths[view], measured, view) for view in range(views)]
    nodes = EnergyNodes(transmission.columns, transmission.weights, transmission.starts)
    gradient = np.empty((views, bases, 1, pixels), np.float32)

    def one_piece(piece: tuple[int, int]) -> Float64[np.ndarray, "4 channel"]:
        view, first = piece
        part = first, min(first + RAYS_PER_PIECE, pixels)
        room, sums = np.empty((2 + bases, BLOCK)), np.zeros((4, channels))
        cpu.data_term(rays[view], part, nodes, float(dispersion), LEAST, poisson_means(), room, (gradient[view], sums))
        if np.isnan(rays[view].lengths[..., slice(*part)]).any():  # which the kernel takes for rays that amplify
            sums[:] = np.nan
        return sums

    pieces = [(view, first) for view in range(views) for first in range(0, pixels, RAYS_PER_PIECE)]
    total = np.zeros((4, channels))
    for sums in run_parallel(one_piece, pieces):
        total += sums
    return DataTerm(gradient.reshape(lengths.shape), *total)


def _rays_of_view(lengths: Float[np.ndarray, "basis row column"], measured: MeasuredCounts, view: int) -> cpu.Rays:
    """Collect the rays of one view for the kernel."""
    channels, pixels = len(measured.gains), lengths[0].size
    profile, weights = measured.profile, measured.statistical_weights
    return cpu.Rays(
        flat(lengths, len(lengths), 1, pixels),
        flat(profile, 0 if profile is None else len(profile), pixels),
        flat(measured.counts[view], 1, channels, pixels),
        flat(None if weights is None else weights[view], 0 if weights is None else 1, channels, pixels),
        flat(measured.gains, channels, pixels),
        np.ascontiguousarray(measured.exposure[view : view + 1], np.float64),
    )
