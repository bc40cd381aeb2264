"""Pulses that arrive at random and pile up, followed one by one: an independent check of `spectra.detector.pile_up`."""

import numpy as np

RUNS = (
    40  # whose spread tells the error of their mean; counts that are paired or that exclude each other are not Poisson
)


def counts_of_arrivals(
    heights: np.ndarray, load: float, thresholds: tuple[float, ...], paralyzable: bool, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Counts between thresholds per pulse, `load` of which arrive in a dead time, and their standard error.

    Pulses are rectangles with these heights.
    """
    runs = [_counts(own, load, thresholds, paralyzable, rng) / len(own) for own in np.split(heights, RUNS)]
    return np.mean(runs, axis=0), np.std(runs, axis=0, ddof=1) / np.sqrt(RUNS)


def _counts(
    heights: np.ndarray, load: float, thresholds: tuple[float, ...], paralyzable: bool, rng: np.random.Generator
) -> np.ndarray:
    """Counts between thresholds of one run."""
    times, sums = np.cumsum(rng.exponential(1 / load, len(heights))), np.append(0.0, np.cumsum(heights))
    if paralyzable:  # the signal before and after each arrival
        before = sums[:-1] - sums[np.searchsorted(times, times - 1, side="right")]
        above = [((before < t) & (before + heights >= t)).sum() for t in thresholds]
    else:
        after, first, read = np.searchsorted(times, times + 1), 0, []
        while first < len(heights):
            read.append(sums[after[first]] - sums[first])
            first = after[first]
        above = [(np.array(read) >= t).sum() for t in thresholds]
    return -np.diff(np.append(above, 0))
