"""Counts that are not whole: of channels that some views lack, and of pixels that saturate.

Channels that a view lacks are interpolated between the views before and after. Readings of pixels that saturate end at
the largest reading of their channel: they are lower bounds of the counts.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int, Real

from recon.data.array_store import read_part
from recon.data.partial_volume import LEAST_COUNTS

# Readings end at the largest one of a channel where it is read so many times, and so many times as often as each of the
# readings within one standard deviation below it; both chosen by hand, not measured.
MANY, OFTEN = 100, 5.0
SAME = 1e-6  # relative difference of readings from the open beam that rounding explains, as in a scan without noise


def interpolate_missing(
    counts: Float[np.ndarray, "view channel row column"],
    exposure: Float[np.ndarray, "view channel"],
    views: Int[np.ndarray, " few"],
) -> tuple[Float[np.ndarray, "few channel row column"], Float[np.ndarray, "few channel"]]:
    """Interpolate missing channels of some views, linearly in the logarithm of counts.

    Parameters
    ----------
    counts : counts of all views
    exposure : tube output of each view and channel, 0 where it was not measured
    views : indices of the views to complete

    Returns
    -------
    counts of these views, and their exposure with 1 for what was interpolated; a channel that no view has stays missing
    """
    completed, known = np.asarray(read_part(counts, views)), exposure[views]
    for c in np.flatnonzero((exposure > 0).any(axis=0)):
        measuring = np.flatnonzero(exposure[:, c] > 0)
        for place in np.flatnonzero(known[:, c] == 0):
            view = views[place]
            after = np.searchsorted(measuring, view)
            a, b = measuring[max(after - 1, 0)], measuring[min(after, len(measuring) - 1)]
            part = (view - a) / (b - a) if b > a else 0.0
            logs = [np.log(np.maximum(counts[v, c], LEAST_COUNTS) / exposure[v, c]) for v in (a, b)]
            completed[place, c] = np.exp((1 - part) * logs[0] + part * logs[1])
            known[place, c] = 1.0
    return completed, known


class LargestReadings:
    """Largest reading of each channel, and how often it is read, collected view by view.

    Parameters
    ----------
    used : pixels whose readings count
    """

    def __init__(self, used: Bool[np.ndarray, "channel row column"]) -> None:
        self.used, channels = used, len(used)
        self.top, self.times = np.zeros(channels), np.zeros(channels)
        self.below, self.of_air = np.zeros(channels), np.zeros(channels)

    def add(
        self, readings: Real[np.ndarray, "channel row column"], open_beam: Real[np.ndarray, "channel row column"]
    ) -> None:
        """Take the readings of a view.

        Parameters
        ----------
        readings : as the detector gave them
        open_beam : what they are without an object
        """
        for c, (image, air, used) in enumerate(zip(readings, open_beam, self.used, strict=True)):
            values = image[used]
            top = float(values.max(initial=0.0))
            if top <= 0 or top < self.top[c]:
                continue
            if top > self.top[c]:
                self.top[c], self.times[c], self.below[c], self.of_air[c] = top, 0, 0, 0
            largest = values == top
            width = max(top**0.5, 1.0)
            self.times[c] += np.count_nonzero(largest)
            self.below[c] += np.count_nonzero((values < top) & (values >= top - width)) / width
            self.of_air[c] += np.count_nonzero(np.abs(top - air[used][largest]) <= SAME * top)

    def limits(self) -> Float[np.ndarray, " channel"]:
        """Find where the readings of each channel end.

        Returns
        -------
        the largest reading; infinite where nothing says that pixels saturate
        """
        ends = (self.times >= MANY) & (self.times > OFTEN * self.below) & (self.of_air < 0.5 * self.times)
        return np.where(ends, self.top, np.inf)


def saturation_notes(channels: Sequence[str], parts: Float[np.ndarray, " channel"]) -> tuple[str, ...]:
    """Tell a user which channels saturate.

    Parameters
    ----------
    channels : their names
    parts : part of the counts of each that are lower bounds

    Returns
    -------
    one sentence; none where no channel does
    """
    named = [f"{100 * part:.2g} % of {name}" for name, part in zip(channels, parts, strict=True) if part > 0]
    if not named:
        return ()
    return (
        f"Pixels saturate: {', '.join(named)} end at the largest reading of the channel. The fit takes these readings "
        "for lower bounds; what only such rays pass is known less well.",
    )
