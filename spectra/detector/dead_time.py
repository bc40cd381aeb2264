"""Dead time and pile-up: counts that a pixel loses while it is busy with the count before.

With n the rate of events above the lowest threshold and tau the dead time, a non-paralyzable counter records
n / (1 + n tau), a paralyzable one, whose dead time every event prolongs, n exp(-n tau) (Knoll, Radiation Detection and
Measurement, chapter 4). All channels of a pixel lose the same part. Pile-up also changes the height of pulses;
that is left out.
"""

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
