"""Numba kernel of the ray-wise decomposition: Fisher scoring of one ray after the other."""

from typing import no_type_check

import numpy as np
from numba import njit

from spectra.ops.fast_exp import fast_exp


@njit(nogil=True, error_model="numpy")
@no_type_check
def _information(lengths, counts, gains, columns, weights, starts, dispersion, known, ray, score, fisher, slopes):
    """Score and Fisher matrix of one ray under the negative binomial model with variance Y + (dispersion Y)^2."""
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
            if known is not None:
                for p in range(known.shape[1]):
                    exponent -= columns[bases + p, k] * known[ray, p]
            part = gains[c] * weights[k] * fast_exp(min(exponent, 60.0))
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
            factor[i, j] = np.sqrt(max(s, 1e-300)) if i == j else s / factor[j, j]
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
def decompose(
    counts, gains, columns, weights, starts, dispersion, prior, iterations, tolerance, largest_step, first, last,
    known, lengths, fishers,
):  # fmt: skip
    """Line integrals (ray, basis), improved in place, and their Fisher matrices, of rays `first` to `last`.

    `known` are lengths (ray, part) in the columns after those of the bases, or None.
    """
    bases = lengths.shape[1]
    score, step, slopes = np.empty(bases), np.empty(bases), np.empty(bases)
    fisher, damped, factor = np.empty((bases, bases)), np.empty((bases, bases)), np.zeros((bases, bases))
    for ray in range(first, last):
        for iteration in range(iterations + 1):
            _information(
                lengths[ray], counts[ray], gains[ray], columns, weights, starts, dispersion, known, ray, score, fisher,
                slopes,
            )  # fmt: skip
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
            shrink = min(1.0, largest_step / max(longest, 1e-300))
            for m in range(bases):
                lengths[ray, m] += shrink * step[m]
            if longest < tolerance:
                break
        fishers[ray] = fisher
