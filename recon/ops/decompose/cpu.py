"""Numba kernel of the ray-wise decomposition: Fisher scoring of one ray after the other."""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float64
from numba import njit

from phantomgen.ops.kernel_decorators import inlined
from recon.ops.arguments import LARGEST_EXPONENT, TINY
from spectra.ops.fast_exp import fast_exp


class Rays(NamedTuple):
    """Counts of rays.

    Parameters
    ----------
    counts : measured counts
    gains : open-beam counts of each ray over those of the energy nodes
    known : lengths of each ray in the columns after those of the bases
    """

    counts: Float64[np.ndarray, "ray channel"]
    gains: Float64[np.ndarray, "ray channel"]
    known: Float64[np.ndarray, "ray part"]


class Scoring(NamedTuple):
    """How Fisher scoring is damped, and when it ends.

    Parameters
    ----------
    prior : inverse variance of a prior centred on 0
    iterations : largest number of steps
    tolerance : a ray is done when no line integral changes by this much in a step
    largest_step : largest change of a line integral in a step
    """

    prior: float
    iterations: int
    tolerance: float
    largest_step: float


class _Room(NamedTuple):
    """Results of `_information` for one ray, and scratch.

    Parameters
    ----------
    score : derivative of the log-likelihood
    fisher : Fisher matrix
    slopes : scratch, derivatives of the expected counts of a channel
    """

    score: Float64[np.ndarray, " basis"]
    fisher: Float64[np.ndarray, "basis basis"]
    slopes: Float64[np.ndarray, " basis"]


@inlined
@no_type_check
def _information(lengths, counts, gains, known, nodes, dispersion, room):
    """Compute score and Fisher matrix of a ray in the negative binomial model with variance Y + (dispersion Y)^2."""
    columns, weights, starts = nodes.columns, nodes.weights, nodes.starts
    score, fisher, slopes = room.score, room.fisher, room.slopes
    bases = lengths.size
    score[:] = 0.0
    fisher[:] = 0.0
    for c in range(starts.size - 1):
        expected = 0.0
        slopes[:] = 0.0
        for k in range(starts[c], starts[c + 1]):
            exponent = 0.0
            for m in range(bases):
                exponent -= columns[m, k] * lengths[m]
            for p in range(known.size):
                exponent -= columns[bases + p, k] * known[p]
            part = gains[c] * weights[k] * fast_exp(min(exponent, LARGEST_EXPONENT))
            expected += part
            for m in range(bases):
                slopes[m] -= part * columns[m, k]
        if expected <= 0.0:
            continue
        precision = 1.0 / (expected * (1.0 + dispersion * dispersion * expected))
        for m in range(bases):
            score[m] += (counts[c] - expected) * precision * slopes[m]
            for n in range(bases):
                fisher[m, n] += slopes[m] * slopes[n] * precision


@njit(nogil=True, error_model="numpy")
@no_type_check
def _solve(matrix, right, factor, out):
    """Solve a symmetric positive definite system by Cholesky factorisation."""
    n = right.size
    for i in range(n):
        for j in range(i + 1):
            s = matrix[i, j]
            for k in range(j):
                s -= factor[i, k] * factor[j, k]
            factor[i, j] = np.sqrt(max(s, TINY)) if i == j else s / factor[j, j]
    for i in range(n):
        s = right[i]
        for k in range(i):
            s -= factor[i, k] * out[k]
        out[i] = s / factor[i, i]
    for i in range(n - 1, -1, -1):
        s = out[i]
        for k in range(i + 1, n):
            s -= factor[k, i] * out[k]
        out[i] = s / factor[i, i]


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def decompose(rays, nodes, dispersion, scoring, first, last, lengths, fishers):
    """Improve the line integrals of some rays by Fisher scoring.

    Parameters
    ----------
    rays : `Rays`
    nodes : `recon.ops.arguments.EnergyNodes`
    dispersion : relative model error
    scoring : `Scoring`
    first, last : rays from `first` to one before `last`
    lengths : line integrals, start and result, (ray, basis)
    fishers : written, Fisher matrices at the result, (ray, basis, basis)
    """
    prior, iterations = scoring.prior, scoring.iterations
    bases = lengths.shape[1]
    score, step, slopes = np.empty(bases), np.empty(bases), np.empty(bases)
    fisher, damped, factor = np.empty((bases, bases)), np.empty((bases, bases)), np.zeros((bases, bases))
    room = _Room(score, fisher, slopes)
    for ray in range(first, last):
        counts, gains, known = rays.counts[ray], rays.gains[ray], rays.known[ray]
        for iteration in range(iterations + 1):
            _information(lengths[ray], counts, gains, known, nodes, dispersion, room)
            if iteration == iterations:
                break
            for m in range(bases):
                score[m] -= prior * lengths[ray, m]
                for n in range(bases):
                    damped[m, n] = fisher[m, n]
                damped[m, m] += prior
            _solve(damped, score, factor, step)
            longest = 0.0
            for m in range(bases):
                longest = max(longest, abs(step[m]))
            shrink = min(1.0, scoring.largest_step / max(longest, TINY))
            for m in range(bases):
                lengths[ray, m] += shrink * step[m]
            if longest < scoring.tolerance:
                break
        fishers[ray] = fisher
