"""Likelihood in numba, a block of rays at a time, so that loops over rays become vector instructions."""

from math import log, log1p
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float32, Float64
from numba import njit

from phantomgen.ops.kernel_decorators import inlined
from recon.ops.arguments import LARGEST_EXPONENT
from spectra.ops.fast_exp import FLAGS, fast_exp
from spectra.ops.min_max import smaller


class Rays(NamedTuple):
    """Line integrals and counts of the rays of some views.

    Parameters
    ----------
    lengths : line integrals of the bases
    known : line integrals of further columns, which are the same in all views; none where there are no such columns
    counts : measured counts
    statistical_weights : weight of each count in the likelihood, minus the part that arrived for a lower bound; no
        views where all weights are 1
    gains : open-beam counts of each pixel over those of the energy nodes
    exposure : tube output of each view and channel
    """

    lengths: Float32[np.ndarray, "basis view ray"]
    known: Float32[np.ndarray, "part ray"]
    counts: Float32[np.ndarray, "view channel ray"]
    statistical_weights: Float32[np.ndarray, "view_or_0 channel ray"]
    gains: Float32[np.ndarray, "channel ray"]
    exposure: Float64[np.ndarray, "view channel"]


@inlined
@no_type_check
def _half_deviance(counted, expected, dispersion):
    """Compute half the deviance of one count, see `recon.ops.deviance.deviance`."""
    ratio = counted * log(counted / expected) if counted > 0.0 else 0.0
    if dispersion == 0.0:
        return ratio - counted + expected
    k = 1.0 / (dispersion * dispersion)
    change = (counted - expected) / (expected + k)
    if change < -0.5:  # where rounding could make it -1
        return ratio - (counted + k) * log((counted + k) / (expected + k))
    return ratio - (counted + k) * log1p(change)


@inlined
@no_type_check
def _at_bound(counted, share, expected, dispersion):
    """Count, weight and constant of the deviance of a lower bound, see `recon.ops.deviance.at_bounds`."""
    reading, variance = -share * counted, counted + dispersion * dispersion * counted * counted
    weight = variance / max((counted - reading) * (counted - reading) / 12.0, variance)
    if expected >= reading:
        return counted, weight, 0.0
    both = 1.0 + weight
    middle = (weight * counted + reading) / both
    constant = weight * _half_deviance(counted, reading, dispersion) - both * _half_deviance(
        middle, reading, dispersion
    )
    return middle, both, 2.0 * constant


@njit(forceinline=True, fastmath=FLAGS, error_model="numpy")
@no_type_check
def _arrive(rays, view, nodes, k, start, count, arriving):
    """Write what arrives of node `k`, for gain 1, of `count` rays from `start` on."""
    lengths, known, columns = rays.lengths, rays.known, nodes.columns
    bases = lengths.shape[0]
    for i in range(count):
        arriving[i] = 0.0
    for m in range(bases):
        factor = columns[m, k]
        for i in range(count):
            arriving[i] -= factor * lengths[m, view, start + i]
    for p in range(known.shape[0]):
        factor = columns[bases + p, k]
        for i in range(count):
            arriving[i] -= factor * known[p, start + i]
    weight = nodes.weights[k]
    for i in range(count):
        arriving[i] = weight * fast_exp(smaller(arriving[i], LARGEST_EXPONENT))


@njit(forceinline=True, fastmath=FLAGS, error_model="numpy")
@no_type_check
def _transmit(rays, view, nodes, channel, start, count, room):
    """Write expected counts and their slopes, for gain 1, of `count` rays from `start` on into the rows of `room`."""
    bases = rays.lengths.shape[0]
    arriving = room[1 + bases]
    for row in range(1 + bases):
        for i in range(count):
            room[row, i] = 0.0
    for k in range(nodes.starts[channel], nodes.starts[channel + 1]):
        _arrive(rays, view, nodes, k, start, count, arriving)
        for i in range(count):
            room[0, i] += arriving[i]
        for m in range(bases):
            factor = nodes.columns[m, k]
            for i in range(count):
                room[1 + m, i] -= factor * arriving[i]


@njit(forceinline=True, fastmath=FLAGS, error_model="numpy")
@no_type_check
def _add_second_derivatives(rays, view, nodes, channel, start, count, room, found):
    """Add the second derivatives of the expected counts, times the last row of `room`, for the rays of `_transmit`."""
    bases = rays.lengths.shape[0]
    arriving, factors = room[1 + bases], room[2 + bases]
    if found.shape[0] == 0:
        return
    for k in range(nodes.starts[channel], nodes.starts[channel + 1]):
        _arrive(rays, view, nodes, k, start, count, arriving)
        pair = 0
        for m in range(bases):
            for n in range(m, bases):
                factor = nodes.columns[m, k] * nodes.columns[n, k]
                for i in range(count):
                    found[pair, view, start + i] += factor * factors[i] * arriving[i]
                pair += 1


@inlined
@no_type_check
def _noise_deviance(expected, dispersion, table):
    """Compute the mean deviance of a count where noise is alone, see `recon.ops.deviance.expected_deviance`."""
    least, step, means = table
    last = means.size - 1
    place = min(log(expected / least) / step, float(last)) if expected > least else 0.0
    low = min(int(place), last - 1)
    part = place - low
    mean = means[low] + part * (means[low + 1] - means[low])
    return min(expected / least, 1.0) * mean / (1.0 + dispersion * dispersion * expected)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def data_term(rays, part, nodes, dispersion, least, table, room, written):
    """Compute the sums of `recon.ops.likelihood.data_term.DataTerm` and the gradient for some rays of one view.

    Parameters
    ----------
    rays : `Rays` of one view
    part : first ray, and the one after the last
    nodes : `recon.ops.arguments.EnergyNodes`
    dispersion : relative model error
    least : counts; where fewer are expected, the deviance is that of `least`, and the gradient is 0
    table : `recon.ops.deviance.PoissonMeans`
    room : scratch, (2 + basis, rays at once): expected counts, slopes, what arrives
    written : derivative of half the deviance in the line integrals, (basis, 1, ray); sums, added to, (4, channel):
        deviance, that of noise alone, chi-square, that of noise alone
    """
    counts, statistical_weights, gains, exposure = rays.counts, rays.statistical_weights, rays.gains, rays.exposure
    gradient, sums = written
    bases, block, squared = rays.lengths.shape[0], room.shape[1], dispersion * dispersion
    for start in range(np.uint64(part[0]), np.uint64(part[1]), np.uint64(block)):
        count = np.uint64(min(block, part[1] - start))
        for m in range(bases):
            for i in range(count):
                gradient[m, 0, start + i] = 0.0
        for c in range(nodes.starts.size - 1):
            _transmit(rays, 0, nodes, c, start, count, room)
            for i in range(count):
                scale = gains[c, start + i] * exposure[0, c]
                if not scale > 0.0:
                    continue
                share = statistical_weights[0, c, start + i] if statistical_weights.shape[0] > 0 else 1.0
                expected, counted = scale * room[0, i], float(counts[0, c, start + i])
                variance = max(expected + squared * expected * expected, 1.0)
                if share < 0.0:
                    counted, share, constant = _at_bound(counted, share, max(expected, least), dispersion)
                    sums[0, c] += constant
                else:
                    sums[2, c] += (counted - expected) * (counted - expected) / variance
                    sums[3, c] += expected / variance
                if share == 0.0:
                    continue
                sums[0, c] += 2.0 * share * _half_deviance(counted, max(expected, least), dispersion)
                sums[1, c] += share * _noise_deviance(expected, dispersion, table)
                if expected < least:
                    continue
                to_value = share * scale * (expected - counted) / (expected * (1.0 + squared * expected))
                for m in range(bases):
                    gradient[m, 0, start + i] += to_value * room[1 + m, i]


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def likelihood(rays, view, nodes, dispersion, least, room, written):
    """Compute the deviance of one view, its gradient and its curvature.

    Parameters
    ----------
    rays : `Rays`
    view : number of the view
    nodes : `recon.ops.arguments.EnergyNodes`
    dispersion : relative model error
    least : counts; where fewer are expected, the deviance is that of `least`, and gradient and curvature are 0
    room : scratch, (3 + basis, rays at once): expected counts, slopes, what arrives of a node, factors of second
        derivatives
    written : derivative of half the deviance in the line integrals, (basis, view, ray); curvatures and residual
        curvatures as in `recon.ops.likelihood.Likelihood`, (pair, view, ray); no pairs where they are not requested

    Returns
    -------
    deviance of the view, each count times its share
    """
    gradient, fisher, residual = written
    counts, statistical_weights, gains, exposure = rays.counts, rays.statistical_weights, rays.gains, rays.exposure
    bases, _, size = rays.lengths.shape
    squared = dispersion * dispersion
    view = np.uint64(view)  # unsigned: no index counts from the end, so loops become vector instructions
    total, block = 0.0, room.shape[1]
    for start in range(np.uint64(0), np.uint64(size), np.uint64(block)):
        count = np.uint64(min(block, size - start))
        for i in range(count):
            for m in range(bases):
                gradient[m, view, start + i] = 0.0
            for p in range(fisher.shape[0]):
                fisher[p, view, start + i] = 0.0
                residual[p, view, start + i] = 0.0
        for c in range(nodes.starts.size - 1):
            _transmit(rays, view, nodes, c, start, count, room)
            for i in range(count):
                room[2 + bases, i] = 0.0
                scale = gains[c, start + i] * exposure[view, c]
                share = statistical_weights[view, c, start + i] if statistical_weights.shape[0] > 0 else 1.0
                expected, counted = scale * room[0, i], float(counts[view, c, start + i])
                whole = share if share >= 0.0 else 2.0  # of curvatures, the most that a lower bound can have
                bound = (
                    _at_bound(counted, share, max(expected, least), dispersion)
                    if share < 0.0
                    else (counted, share, 0.0)
                )
                counted, share, constant = bound
                total += constant
                if expected >= least or (counted > 0.0 and scale > 0.0):
                    total += 2.0 * share * _half_deviance(counted, max(expected, least), dispersion)
                if expected < least:
                    continue
                precision = share * scale / (expected * (1.0 + squared * expected))
                to_value = (expected - counted) * precision
                room[2 + bases, i] = max(to_value, 0.0)
                most = max(expected, counted)
                precision = whole * scale * scale * most
                precision /= expected * expected * (1.0 + squared * most)
                for m in range(bases):
                    gradient[m, view, start + i] += to_value * room[1 + m, i]
                pair = 0
                if fisher.shape[0] > 0:
                    for m in range(bases):
                        for n in range(m, bases):
                            fisher[pair, view, start + i] += precision * room[1 + m, i] * room[1 + n, i]
                            pair += 1
            _add_second_derivatives(rays, view, nodes, c, start, count, room, residual)
    return total
