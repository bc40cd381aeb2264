"""Likelihood in numba, a block of rays at a time, so that loops over rays become vector instructions."""

from math import log, log1p
from typing import no_type_check

import numpy as np
from numba import njit

from phantomgen.ops.kernel_decorators import inlined
from spectra.ops.fast_exp import FLAGS, fast_exp
from spectra.ops.min_max import smaller


@inlined
@no_type_check
def _half_deviance(counted, expected, dispersion):
    """Half the deviance of one count, see `recon.ops.deviance.deviance`."""
    ratio = counted * log(counted / expected) if counted > 0.0 else 0.0
    if dispersion == 0.0:
        return ratio - counted + expected
    k = 1.0 / (dispersion * dispersion)
    change = (counted - expected) / (expected + k)
    if change < -0.5:  # where rounding could make it -1
        return ratio - (counted + k) * log((counted + k) / (expected + k))
    return ratio - (counted + k) * log1p(change)


@njit(forceinline=True, fastmath=FLAGS, error_model="numpy")
@no_type_check
def _transmit(lengths, known, view, columns, weights, first, last, start, count, room):
    """Write expected counts and their slopes, for gain 1, of `count` rays from `start` on into the rows of `room`."""
    bases = lengths.shape[0]
    for row in range(1 + bases):
        for i in range(count):
            room[row, i] = 0.0
    for k in range(first, last):
        exponents = room[1 + bases]
        for i in range(count):
            exponents[i] = 0.0
        for m in range(bases):
            factor = columns[m, k]
            for i in range(count):
                exponents[i] -= factor * lengths[m, view, start + i]
        for p in range(known.shape[0]):
            factor = columns[bases + p, k]
            for i in range(count):
                exponents[i] -= factor * known[p, start + i]
        weight = weights[k]
        for i in range(count):
            exponents[i] = weight * fast_exp(smaller(exponents[i], 60.0))
            room[0, i] += exponents[i]
        for m in range(bases):
            factor = columns[m, k]
            for i in range(count):
                room[1 + m, i] -= factor * exponents[i]


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def likelihood(
    lengths, known, counts, shares, gains, exposure, view,
    columns, weights, starts, dispersion, least, room, gradient, fisher,
):  # fmt: skip
    """Deviance of one view.

    Parameters
    ----------
    lengths, known : line integrals of the bases, and of further columns, (basis, view, ray), (part, ray)
    counts, shares : (view, channel, ray); no views of shares where each count has its whole say
    gains, exposure : (channel, ray), (view, channel)
    view : which one
    columns, weights, starts : energy nodes grouped by channel
    dispersion, least : relative model error; expected counts below which a channel has no say
    room : scratch (2 + basis, rays at once): expected counts, slopes, exponents
    gradient, fisher : written, (basis, view, ray), (pair, view, ray); no pairs where the information is not wanted
    """
    bases, _, rays = lengths.shape
    view = np.uint64(view)  # unsigned: no index counts from the end, so loops become vector instructions
    total, block = 0.0, room.shape[1]
    for start in range(np.uint64(0), np.uint64(rays), np.uint64(block)):
        count = np.uint64(min(block, rays - start))
        for i in range(count):
            for m in range(bases):
                gradient[m, view, start + i] = 0.0
            for p in range(fisher.shape[0]):
                fisher[p, view, start + i] = 0.0
        for c in range(starts.size - 1):
            _transmit(lengths, known, view, columns, weights, starts[c], starts[c + 1], start, count, room)
            for i in range(count):
                scale = gains[c, start + i] * exposure[view, c]
                share = shares[view, c, start + i] if shares.shape[0] > 0 else 1.0
                expected, counted = scale * room[0, i], float(counts[view, c, start + i])
                if expected < least:
                    if counted > 0.0 and scale > 0.0:
                        total += 2.0 * share * _half_deviance(counted, least, dispersion)
                    continue
                total += 2.0 * share * _half_deviance(counted, expected, dispersion)
                precision = share * scale / (expected * (1.0 + dispersion * dispersion * expected))
                to_value = (expected - counted) * precision
                most = max(expected, counted)
                precision = share * scale * scale * most
                precision /= expected * expected * (1.0 + dispersion * dispersion * most)
                for m in range(bases):
                    gradient[m, view, start + i] += to_value * room[1 + m, i]
                pair = 0
                if fisher.shape[0] > 0:
                    for m in range(bases):
                        for n in range(m, bases):
                            fisher[pair, view, start + i] += precision * room[1 + m, i] * room[1 + n, i]
                            pair += 1
    return total
