"""Counts of pixels from regular grids of rays, with more rays in pixels where their own error would decide.

A grid of n x n rays errs across an edge by about 1 / n^1.5 of its jump, and by up to 1 / n where the edge runs along
the rows. So a few pixels of a sample may differ from a setting because the grid is too coarse, not the setting.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int

from spectra.threads import run_parallel

# Rays along each edge of a pixel that the reference begins with.
RAYS = 256
# A grid has at most so many rays per side, in parts of at most `_PART`, to spare memory.
_MOST_RAYS, _PART = 2048, 1024
# Parts of the rays per side must change the counts by no more than this part of a difference that counts; both have
# other places across, as edges along the rows may err alike on grids of which one halves the other.
_DOUBT = 0.25
_COARSER = (0.755, 0.88)
# Counts relative to the open beam, no unit; smaller ones are none.
_LEAST = 1e-12

Frame = Float[np.ndarray, "4 3"]
Counts = Float[np.ndarray, "..."]


@dataclass(frozen=True, eq=False)
class RayGrid:
    """Grids of rays in some pixels of a view.

    Parameters
    ----------
    pixels : row and column
    counts_of : counts (1, channel) of pixels (1, 2) by so many rays per side
    known : counts that were computed before, by pixel and rays per side
    """

    pixels: Int[np.ndarray, "pixel 2"]
    counts_of: Callable[[Int[np.ndarray, "1 2"], int], Float[np.ndarray, "1 channel"]]
    known: dict[tuple[int, int], Float[np.ndarray, " channel"]] = field(default_factory=dict)

    def worst(
        self,
        found: Float[np.ndarray, "channel row column"],
        chosen: Bool[np.ndarray, " pixel"],
        level: Float[np.ndarray, " channel"],
        share: float,
    ) -> float:
        """Compute the worst difference of log counts in chosen pixels.

        Differences below `share` need no more rays.

        Parameters
        ----------
        found : counts to be judged, of the whole view
        chosen : pixels to judge them by
        level : highest counts, below 1e-12 of which there is nothing to measure
        share : error that is allowed

        Returns
        -------
        largest absolute difference
        """

        def error(i: int) -> float:
            row, column = self.pixels[i]
            return self._error(i, found[:, row, column], level, share)

        return max(run_parallel(error, np.flatnonzero(chosen).tolist()), default=0.0)

    def _error(self, i: int, found: Counts, level: Counts, share: float) -> float:
        """Compute the error of one pixel; rays are doubled while both the difference and its uncertainty are too large.

        A strip between two rows of rays stays unseen: where all rays are dark, less than that may be open.
        """
        rays = RAYS
        while True:
            exact = self._counts(i, rays)
            error = worst_error(found, exact, level)
            if error <= share:
                return error
            if rays == _MOST_RAYS:
                return worst_error(found, exact, level, 1 / rays)
            coarser = (self._counts(i, int(part * rays)) for part in _COARSER)
            doubt = max(worst_error(counts, exact, level) for counts in coarser)
            told = worst_error(found, exact, level, 1 / rays) > share  # or all rays of the grid may miss what is open
            if told and doubt <= _DOUBT * error:
                return error
            rays *= 2

    def _counts(self, i: int, rays: int) -> Float[np.ndarray, " channel"]:
        """Return the counts of one pixel."""
        if (i, rays) not in self.known:
            self.known[i, rays] = self.counts_of(self.pixels[i : i + 1], rays)[0]
        return self.known[i, rays]


def split_grid(
    counts_of: Callable[[Frame, tuple[float, float], int], Counts],
    frame: Frame,
    aperture: tuple[float, float],
    rays: int,
) -> Counts:
    """Compute the mean over `rays` x `rays` rays of each pixel, in parts of a pixel where the rays are many.

    Parameters
    ----------
    counts_of : counts by frame, part of a pixel's width and height that rays cover around its centre, and rays per side
    frame : source, vector from there to the centre of pixel (0, 0), column step, row step [mm]
    aperture : part of a pixel's width and height that is sensitive
    rays : per side

    Returns
    -------
    counts, (channel, row, column)
    """
    parts = -(-rays // _PART)
    places = (np.arange(parts) + 0.5) / parts - 0.5
    counts = []
    for across, down in np.stack(np.meshgrid(places, places), axis=-1).reshape(-1, 2):
        shifted = frame.copy()
        shifted[1] += across * aperture[0] * frame[2] + down * aperture[1] * frame[3]
        counts.append(counts_of(shifted, (aperture[0] / parts, aperture[1] / parts), rays // parts))
    return np.mean(counts, axis=0)


def worst_error(counts: Counts, exact: Counts, level: Counts, unseen: float = 0.0) -> float:
    """Compute the worst difference of log counts where either has anything left to measure.

    Parameters
    ----------
    counts, exact : what is judged, and what by
    level : highest counts
    unseen : part of a pixel that what it is judged by may miss: it cannot tell that from a pixel that is dark

    Returns
    -------
    largest absolute difference
    """
    level = np.broadcast_to(level, np.shape(counts))
    lit = level > 0
    left, wanted = (np.divide(c, level, out=np.zeros(np.shape(c)), where=lit) for c in (counts, exact))
    return float(np.abs(log_errors(left, wanted, unseen)).max(initial=0.0))


def log_errors(left: Counts, wanted: Counts, unseen: float = 0.0) -> Counts:
    """Compute differences of log counts.

    Counts are fractions of the open beam. Fractions below 1e-12 are set to 1e-12: a pixel that is wrongly dark errs by
    up to 28, and where both are dark there is nothing to measure. The reference may be dark because it misses a part of
    a pixel; while `unseen` is larger than what is left, that is no error.

    Parameters
    ----------
    left : counts to judge, as fractions of the open beam
    wanted : reference counts, as fractions of the open beam
    unseen : part of a pixel that the reference may miss

    Returns
    -------
    differences, 0 where there is nothing to measure
    """
    errors = np.log(np.maximum(left, _LEAST) / np.maximum(wanted, _LEAST))
    return np.where((wanted <= _LEAST) & (left <= unseen), 0.0, errors)
