"""Expected counts in numba, one ray after the other.

Nodes are grouped by channel: channel c owns the nodes ``starts[c]`` to ``starts[c + 1]``. `expected_ray` is the device
function that other kernels call for one ray; the rest are loops over rays.
"""

from math import log
from typing import no_type_check

import numpy as np
from numba import njit

from spectra.ops.fast_exp import FLAGS, LANES, attenuated_lanes, fast_exp
from spectra.ops.min_max import larger, smaller

# Sums may be reordered; NaN and infinity keep their meaning.
_REORDER = {"reassoc", "contract", "nsz"}


@njit(forceinline=True, nogil=True, fastmath=FLAGS, error_model="numpy")
@no_type_check
def expected_ray(lengths, columns, weights, starts, out):
    """Write the expected counts of one ray: ``out[c] = sum_k w_k exp(-sum_m columns[m, k] lengths[m])``.

    Parameters
    ----------
    lengths : line integrals of the ray, (M,)
    columns : functions of energy at the nodes, (M, K)
    weights : photons x response of each node
    starts : first node of each channel, and the number of nodes
    out : result, (C,)
    """
    nodes = weights.size
    for c in range(starts.size - 1):
        total = 0.0
        k = starts[c]
        while nodes >= LANES and k < starts[c + 1]:
            # The last lanes of a channel are masked out: they hold its neighbour's nodes, or lie before `k`.
            total += attenuated_lanes(lengths, columns, weights, smaller(k, nodes - LANES), k, starts[c + 1])
            k += LANES
        while k < starts[c + 1]:
            exponent = 0.0
            for m in range(lengths.size):
                exponent -= lengths[m] * columns[m, k]
            total += weights[k] * fast_exp(exponent)
            k += 1
        out[c] = total


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def expected_counts(lengths, columns, weights, starts, out):
    """Write the expected counts of many rays.

    Parameters
    ----------
    lengths : line integrals, (R, M)
    columns : functions of energy at the nodes, (M, K)
    weights : photons x response of each node
    starts : first node of each channel, and the number of nodes
    out : result, (R, C)
    """
    for ray in range(lengths.shape[0]):
        expected_ray(lengths[ray], columns, weights, starts, out[ray])


@njit(cache=True, nogil=True, fastmath=_REORDER, error_model="numpy")
@no_type_check
def expected_and_jacobian(lengths, columns, weights, starts, out, jacobian):
    """Write the expected counts and their derivatives dY_c/dL_m.

    Parameters
    ----------
    lengths : line integrals, (R, M)
    columns : functions of energy at the nodes, (M, K)
    weights : photons x response of each node
    starts : first node of each channel, and the number of nodes
    out : resulting counts, (R, C)
    jacobian : resulting derivatives, (R, C, M)
    """
    for ray in range(lengths.shape[0]):
        for c in range(starts.size - 1):
            total = 0.0
            for m in range(lengths.shape[1]):
                jacobian[ray, c, m] = 0.0
            for k in range(starts[c], starts[c + 1]):
                exponent = 0.0
                for m in range(lengths.shape[1]):
                    exponent -= lengths[ray, m] * columns[m, k]
                part = weights[k] * fast_exp(exponent)
                total += part
                for m in range(lengths.shape[1]):
                    jacobian[ray, c, m] -= part * columns[m, k]
            out[ray, c] = total


@njit(cache=True, nogil=True, fastmath=_REORDER, error_model="numpy")
@no_type_check
def log_counts_and_slopes(lengths, columns, weights, starts, log_counts, slopes):
    """Write the log of the expected counts, -inf for a channel without nodes, and -d(log Y_c)/dL_m.

    Exponents are taken relative to the most penetrating node of the channel, so that nothing underflows.

    Parameters
    ----------
    lengths : line integrals, (R, M)
    columns : functions of energy at the nodes, (M, K)
    weights : photons x response of each node
    starts : first node of each channel, and the number of nodes
    log_counts : resulting log counts, (R, C)
    slopes : resulting slopes, (R, C, M)
    """
    exponents = np.empty(weights.size)
    for ray in range(lengths.shape[0]):
        for c in range(starts.size - 1):
            shift = -np.inf
            for k in range(starts[c], starts[c + 1]):
                exponents[k] = 0.0
                for m in range(lengths.shape[1]):
                    exponents[k] -= lengths[ray, m] * columns[m, k]
                shift = larger(shift, exponents[k])
            total = 0.0
            for m in range(lengths.shape[1]):
                slopes[ray, c, m] = 0.0
            for k in range(starts[c], starts[c + 1]):
                part = weights[k] * fast_exp(exponents[k] - shift)
                total += part
                for m in range(lengths.shape[1]):
                    slopes[ray, c, m] += part * columns[m, k]
            log_counts[ray, c] = shift + log(total) if total > 0.0 else -np.inf
            scale = 1.0 / total if total > 0.0 else 0.0
            for m in range(lengths.shape[1]):
                slopes[ray, c, m] *= scale
