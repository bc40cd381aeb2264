"""Dead time and pile-up: counts that a pixel loses while it is busy with the count before.

With n the rate of events above the lowest threshold and tau the dead time, a non-paralyzable counter records
n / (1 + n tau), a paralyzable one, whose dead time every event prolongs, n exp(-n tau) (Knoll, Radiation Detection and
Measurement, chapter 4). All channels of a pixel lose the same part. That pile-up also changes the height of pulses is
left to `spectra.detector.pile_up`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.special import lambertw

from spectra.errors import InputError

# Above this load, events per dead time, a recorded rate no longer determines the true one.
_SATURATED = 20.0

# Recorded counts per dead time of a paralyzable counter at the load 1, less rounding.
_MOST_RECORDED = np.exp(-1) * (1 - 1e-12)

# Part of a pixel's events by which each channel is changed to find how recorded counts depend on events.
_CHANGE = 1e-4

Counts = Float[np.ndarray, "... channel row column"]
Image = Float[np.ndarray, "..."]


@dataclass(frozen=True)
class DeadTime:
    """Dead time of a pixel.

    Parameters
    ----------
    tau_ns : dead time after a count [ns]
    exposure_ms : time of one view, and of one flat [ms]
    model : ``nonparalyzable``, or ``paralyzable`` where events in the dead time prolong it
    """

    tau_ns: float
    exposure_ms: float
    model: Literal["nonparalyzable", "paralyzable"] = "nonparalyzable"

    def __post_init__(self) -> None:
        for name, value, unit in (("dead time", self.tau_ns, "ns"), ("exposure", self.exposure_ms, "ms")):
            if not 0 < value < np.inf:
                raise InputError(f"the {name} must be positive and finite, got {value:g} {unit}")
        if self.model not in ("nonparalyzable", "paralyzable"):
            raise InputError(f"unknown model of dead time {self.model!r}: choose nonparalyzable or paralyzable")

    @property
    def per_count(self) -> float:
        """Dead time over exposure time: load per event."""
        return self.tau_ns * 1e-6 / self.exposure_ms

    @property
    def highest_load(self) -> float:
        """Events per dead time up to which recorded counts can be corrected."""
        return _SATURATED if self.model == "nonparalyzable" else 1.0

    def live(self, events: Image) -> Image:
        """Compute the fraction of the events that is recorded.

        Parameters
        ----------
        events : events of all channels in the exposure time, per pixel

        Returns
        -------
        fraction from 0 to 1
        """
        load = self.per_count * events
        return 1 / (1 + load) if self.model == "nonparalyzable" else np.exp(-load)

    def fano(self, events: Image) -> Image:
        """Compute the variance of all recorded counts over their mean, 1 / (1 + x)^2 or 1 - 2 x exp(-x) with load x.

        It holds for exposures of many dead times.

        Parameters
        ----------
        events : events of all channels in the exposure time, per pixel

        Returns
        -------
        variance over mean, per pixel

        References
        ----------
        Yu & Fessler 2000, Physics in Medicine and Biology 45, 2043, doi:10.1088/0031-9155/45/7/324
        """
        load = self.per_count * events
        return (1 + load) ** -2 if self.model == "nonparalyzable" else 1 - 2 * load * np.exp(-load)

    def recorded(self, events: Counts) -> Counts:
        """Compute the mean recorded counts of each channel.

        Parameters
        ----------
        events : mean events, (..., channel, row, column)

        Returns
        -------
        mean recorded counts, (..., channel, row, column)
        """
        return events * self.live(events.sum(axis=-3, keepdims=True))

    def corrected(self, recorded: Counts) -> Counts:
        """Compute the events of each channel from recorded counts, the inverse of `recorded` up to `highest_load`.

        Parameters
        ----------
        recorded : recorded counts, (..., channel, row, column)

        Returns
        -------
        events, (..., channel, row, column)
        """
        load = self.per_count * recorded.sum(axis=-3, keepdims=True)
        if self.model == "nonparalyzable":
            return recorded * (1 + np.minimum(load / np.maximum(1 - load, 1e-9), _SATURATED))
        true_load = -np.real(lambertw(-np.clip(load, 0.0, _MOST_RECORDED)))
        return recorded * np.exp(true_load)


def corrected_spread(
    events: Float[np.ndarray, "channel row column"],
    recorded: Callable[[Float[np.ndarray, "channel row column"]], Float[np.ndarray, "channel row column"]],
    dead_time: DeadTime,
) -> Float[np.ndarray, "channel row column"]:
    """Compute the variance over the mean of events that are found from recorded counts.

    All recorded counts together have the variance of `DeadTime.fano`, and are split between channels at random. A
    correction magnifies that: by 1 + x in a non-paralyzable counter with x events per dead time, by more where heights
    of pulses add.

    Parameters
    ----------
    events : mean events of one frame
    recorded : function from mean events to mean recorded counts
    dead_time : of the pixels

    Returns
    -------
    variance over mean of each channel; 1 where there are no events
    """
    counts, total = recorded(events), events.sum(axis=0)
    change = _CHANGE * np.maximum(total, 1.0)
    unit = np.eye(len(events))[:, :, None, None]
    slopes = np.stack([(recorded(events + change * one) - counts) / change for one in unit], axis=-1)
    inverse = np.linalg.inv(np.moveaxis(slopes, 0, -2))  # (row, column, channel of events, channel of counts)
    pixels = np.moveaxis(counts, 0, -1)
    independent = (inverse**2 @ pixels[..., None])[..., 0]
    together = (inverse @ pixels[..., None])[..., 0] ** 2 / np.maximum(counts.sum(axis=0), 1e-30)[..., None]
    variance = independent + (dead_time.fano(total)[..., None] - 1) * together
    return np.where(events > 0, np.moveaxis(variance, -1, 0) / np.where(events > 0, events, 1.0), 1.0)
