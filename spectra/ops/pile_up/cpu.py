"""Counts of pulses that pile up, in numba, one pixel after the other.

Heights of pulses lie on a lattice whose point s stands for heights from s - 1/2 to s + 1/2 steps. The sum of the pulses
that arrive in a dead time has a compound Poisson distribution; up to the last threshold it follows from Panjer's
recursion, f(s) = 1/s sum_j j r(j) f(s - j), with r(j) the mean number of pulses of height j per dead time.
"""

from typing import no_type_check

import numpy as np
from numba import njit

from spectra.ops.min_max import larger

# Events are found when they give all recorded counts within this part of their sum, or after so many steps.
_NEAR = 1e-5
_MOST_STEPS = 100


@njit(nogil=True, error_model="numpy")
@no_type_check
def _counts(events, load, idle, paralyzable, lattice, rates, piled, out):
    """Write the counts between thresholds of one pixel; see `counts`. `rates` and `piled` are room for the lattice."""
    first, parts, below, whole, part = lattice
    total = events.sum()
    if not load > 0:
        out[:] = 0
        return
    rates[:] = 0
    for g in range(first.size):
        for i in range(parts.shape[1]):
            if parts[g, i] > 0:
                rates[first[g] + i] += parts[g, i] * events[g] * (load / total)
    low = first[0] if first.size else rates.size
    # `piled`: the sum of the pulses that are there. From the top down, as what lies below is still needed: `rates`
    # becomes that and one pulse more, and `piled` loses single pulses, which the groups tell more exactly.
    piled[0] = 0
    for s in range(1, rates.size):
        more = s * rates[s] * idle
        for j in range(low, s - low + 1):
            more += j * rates[j] * piled[s - j]
        piled[s] = more / s
    for s in range(rates.size - 1, -1, -1):
        more = 0.0
        for j in range(low, s - low + 1):
            more += rates[j] * piled[s - j]
        piled[s] -= idle * rates[s]
        rates[s] = more / load
    for k in range(out.size):
        alone, low_sum, low_pile = 0.0, 0.0, 0.0
        for g in range(below[k]):
            alone += events[g]
        for s in range(whole[k]):
            low_sum += rates[s]
            low_pile += piled[s]
        low_sum += idle * alone / total + part[k] * rates[whole[k]]
        low_pile += idle * (1 + load * alone / total) + part[k] * piled[whole[k]]
        out[k] = total * (low_pile - low_sum) if paralyzable else total / (1 + load) * (1 - low_sum)
    for k in range(out.size - 1):
        out[k] = larger(out[k] - out[k + 1], 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def counts(events, load, lattice, out):
    """Write the mean recorded counts between thresholds.

    Parameters
    ----------
    events : mean pulses of each group of heights, (P, G)
    load, lattice : see `spectra.ops.pile_up.Load` and `Lattice`, as tuples
    out : result, (P, K)
    """
    loads, idle, paralyzable = load
    points = lattice[3][-1] + 1
    rates, piled = np.empty(points), np.empty(points)
    for p in range(len(events)):
        _counts(events[p], loads[p], idle[p], paralyzable, lattice, rates, piled, out[p])


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def events(recorded, totals, load, lattice, shapes, out):
    """Write the mean events between thresholds that give recorded counts.

    Parameters
    ----------
    recorded : counts between thresholds, (P, K)
    totals : events of all channels, (P,)
    load, lattice, shapes : see `spectra.ops.pile_up.Load`, `Lattice` and `Shapes`, as tuples
    out : result, (P, K)
    """
    loads, idle, paralyzable = load
    parts, places, starts = shapes
    points, channels = lattice[3][-1] + 1, recorded.shape[1]
    rates, piled, pulses, found = np.empty(points), np.empty(points), np.empty(parts.shape[1]), np.empty(channels)
    for p in range(len(recorded)):
        wanted = 0.0
        for k in range(channels):
            wanted += larger(recorded[p, k], 0.0)
        if not (wanted > 0 and loads[p] > 0):
            out[p] = recorded[p]
            continue
        for k in range(channels):
            out[p, k] = larger(recorded[p, k], 0.0) / wanted * totals[p]
        row = min(int(places[p]), len(parts) - 2)
        weight = places[p] - row
        for _ in range(_MOST_STEPS):
            for k in range(channels):
                for g in range(starts[k], starts[k + 1]):
                    pulses[g] = out[p, k] * ((1 - weight) * parts[row, g] + weight * parts[row + 1, g])
            _counts(pulses, loads[p], idle[p], paralyzable, lattice, rates, piled, found)
            total, missed = 0.0, 0.0
            for k in range(channels):
                target = larger(recorded[p, k], 0.0)
                missed += abs(target - found[k])
                if found[k] > 0:
                    out[p, k] *= target / found[k]
                total += out[p, k]
            for k in range(channels):
                out[p, k] *= totals[p] / total
            if missed <= _NEAR * wanted:
                break
