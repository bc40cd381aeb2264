"""Decompose: from counts to line integrals, ray by ray, by maximum likelihood."""

import numpy as np
from jaxtyping import Float

from recon.ops.arguments import EnergyNodes
from recon.ops.decompose import cpu
from recon.ops.pieces import run_in_pieces
from spectra.errors import InputError
from spectra.transmission import Transmission

CHUNK = 8192  # rays per piece of work
PRIOR = 1e-2  # inverse variance of a prior centred on zero; it matters only for rays without photons
COLLINEAR = 1e-2  # of the largest singular value; smaller ones are left out of the starting values
LARGEST_START = 20.0  # no unit; largest starting value of a line integral, e^-20 of the photons arrive
LARGEST_STEP = 1.0  # no unit; largest change of a line integral in one iteration


def decompose(
    counts: Float[np.ndarray, "ray channel"],
    gains: Float[np.ndarray, "ray channel"],
    transmission: Transmission,
    dispersion: float = 0.0,
    iterations: int = 30,
    tolerance: float = 1e-4,
    known: Float[np.ndarray, "ray part"] | None = None,
) -> tuple[Float[np.ndarray, "ray basis"], Float[np.ndarray, "ray basis basis"]]:
    """Compute maximum-likelihood line integrals of every basis, and their Fisher matrices.

    Parameters
    ----------
    counts : measured counts, zeros included
    gains : open-beam counts of the pixel over those of `transmission`
    transmission : columns are the basis functions, and after them those whose lengths are known
    dispersion : relative model error; the variance is Y + (dispersion Y)^2
    iterations : largest number of steps of a ray
    tolerance : a ray is done when no line integral changes by this much in a step (no unit)
    known : lengths of each ray in the last columns; None where there are none

    Returns
    -------
    line integrals (no unit), and their inverse covariance at the solution

    Raises
    ------
    InputError
        With fewer channels than bases, since then the problem has no single solution.

    References
    ----------
    Roessl & Proksa 2007, doi:10.1088/0031-9155/52/15/020 (maximum likelihood in photon-counting spectral CT).
    """
    bases = len(transmission.columns) - (0 if known is None else known.shape[1])
    if len(transmission) < bases:
        raise InputError(f"{len(transmission)} channels cannot tell {bases} bases apart; use at most as many bases")
    counts, gains = (np.ascontiguousarray(x, dtype=np.float64) for x in (counts, gains))
    lengths = _log_linear(counts, gains, transmission, np.zeros((1, 0)) if known is None else known)
    fishers = np.empty((*lengths.shape, bases))
    rays = cpu.Rays(counts, gains, np.zeros((len(counts), 0)) if known is None else known)
    nodes = EnergyNodes(transmission.columns, transmission.weights, transmission.starts)
    scoring = cpu.Scoring(PRIOR, iterations, tolerance, LARGEST_STEP)
    run_in_pieces(
        lambda first, last: cpu.decompose(rays, nodes, dispersion, scoring, first, last, lengths, fishers),
        len(counts),
        CHUNK,
    )
    return lengths, fishers


def _log_linear(
    counts: Float[np.ndarray, "ray channel"],
    gains: Float[np.ndarray, "ray channel"],
    transmission: Transmission,
    known: Float[np.ndarray, "ray_or_1 part"],
) -> Float[np.ndarray, "ray basis"]:
    """Compute starting values: least squares on log projections with the open-beam mean of each basis per channel.

    Values are limited to 0 ... `LARGEST_START`.
    """
    bases = len(transmission.columns) - known.shape[1]
    open_beam = transmission.open_beam
    if known.shape[1]:
        open_beam = transmission.expected(np.hstack([np.zeros((len(known), bases)), known]))
    projections = -np.log(np.maximum(counts, 0.5) / np.maximum(gains * open_beam, 0.5))
    typical = np.append(np.zeros(bases), known.mean(axis=0))
    means = transmission.log_projection_and_slopes(typical)[1][:, :bases]
    return np.ascontiguousarray(np.clip(projections @ np.linalg.pinv(means, rcond=COLLINEAR).T, 0.0, LARGEST_START))
