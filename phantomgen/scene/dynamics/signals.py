"""Signals that drive a scene: breathing, heartbeat, inflow of a contrast agent, or a table.

A signal has a value at each time. One that repeats has a cycle position as well, from 0 to 1, by which views are
sorted into phases.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from phantomgen.effects.random_streams import Stream, generator
from spectra.errors import InputError

Times = Float[np.ndarray, " time"]
# Cycles that are drawn before the scan, and the most that one scan has.
_EARLIER, _MOST_CYCLES = 1, 10_000
# Least factor of a drawn cycle.
_LEAST = 0.2


class Signal(ABC):
    """Value in time."""

    @abstractmethod
    def values(self, times: Times) -> Times:
        """Compute the values at `times`.

        Parameters
        ----------
        times : [s]

        Returns
        -------
        values, without unit
        """

    def cycles(self, times: Times) -> Times | None:
        """Compute the position in the cycle at `times`.

        Parameters
        ----------
        times : [s]

        Returns
        -------
        positions from 0 to 1; None for a signal that does not repeat
        """
        return None


@dataclass(frozen=True, kw_only=True)
class Periodic(Signal):
    """Signal that repeats after a fixed time.

    Parameters
    ----------
    period : [s]
    start : position in the cycle at time 0
    """

    period: float
    start: float = 0.0

    def cycles(self, times: Times) -> Times:
        """Compute the position in the cycle.

        Parameters
        ----------
        times : [s]

        Returns
        -------
        positions from 0 to 1
        """
        return (times / self.period + self.start) % 1.0


@dataclass(frozen=True, kw_only=True)
class Sine(Periodic):
    """(1 - cos) / 2 of one turn per period; parameters as those of `Periodic`."""

    def values(self, times: Times) -> Times:
        """Compute (1 - cos) / 2.

        Parameters
        ----------
        times : [s]

        Returns
        -------
        values from 0 to 1
        """
        return (1 - np.cos(2 * np.pi * self.cycles(times))) / 2


@dataclass(frozen=True)
class Respiratory(Signal):
    """Breathing: an even power of a cosine, so that the end of exhaling takes the longest.

    Parameters
    ----------
    period : mean duration of a breath [s]
    exponent : half of the power
    start : position in the cycle at time 0
    period_deviation, amplitude_deviation : relative standard deviations from breath to breath
    seed : of the random breaths

    References
    ----------
    Lujan et al. 1999, Medical Physics 26, 715, doi:10.1118/1.598577.
    """

    period: float
    exponent: int = 3
    start: float = 0.0
    period_deviation: float = 0.0
    amplitude_deviation: float = 0.0
    seed: int = 0

    def values(self, times: Times) -> Times:
        """Compute the depth of breath.

        Parameters
        ----------
        times : [s]

        Returns
        -------
        0 at the end of exhaling, 1 at the end of a mean inhaling
        """
        number, position = self._located(times)
        return self._drawn[1][number] * np.sin(np.pi * position) ** (2 * self.exponent)

    def cycles(self, times: Times) -> Times:
        """Compute the position in the breath.

        Parameters
        ----------
        times : [s]

        Returns
        -------
        0 at the end of exhaling, 0.5 at the end of inhaling
        """
        return self._located(times)[1]

    @cached_property
    def _drawn(self) -> tuple[Float[np.ndarray, " end"], Float[np.ndarray, " breath"]]:
        """Ends of all breaths [s], and their amplitudes; more breaths than a scan has."""
        random = generator(self.seed, Stream.SIGNAL, 0, 0)
        normal = random.standard_normal((_MOST_CYCLES, 2)) * [self.period_deviation, self.amplitude_deviation]
        lengths, amplitudes = np.maximum(1 + normal, _LEAST).T
        ends = np.cumsum(self.period * lengths)
        begin = self.start % 1.0 + _EARLIER
        whole = int(begin)
        first = ends[whole - 1] + (begin - whole) * (ends[whole] - ends[whole - 1])
        return np.concatenate([[0.0], ends]) - first, amplitudes

    def _located(self, times: Times) -> tuple[Int[np.ndarray, " time"], Times]:
        """Number of the breath at each time, and the position in it."""
        ends, amplitudes = self._drawn
        number = np.clip(np.searchsorted(ends, times, side="right") - 1, 0, len(amplitudes) - 1)
        return number, np.clip((times - ends[number]) / (ends[number + 1] - ends[number]), 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class Cardiac(Periodic):
    """Contraction of a heart: a rise and a fall, each half a cosine, then rest.

    Parameters
    ----------
    period, start : as those of `Periodic`; contraction begins at position 0
    systole, relaxation : parts of the period in which it contracts, and relaxes

    Raises
    ------
    InputError
        When contraction and relaxation take longer than the period.
    """

    systole: float = 0.35
    relaxation: float = 0.3

    def __post_init__(self) -> None:
        if self.systole + self.relaxation > 1:
            raise InputError(
                f"systole and relaxation are parts of the period, whose sum is at most 1, got {self.systole:g} and "
                f"{self.relaxation:g}"
            )

    def values(self, times: Times) -> Times:
        """Compute the contraction.

        Parameters
        ----------
        times : [s]

        Returns
        -------
        values from 0 to 1
        """
        at = self.cycles(times)
        rise = np.clip(at / self.systole, 0.0, 1.0)
        fall = np.clip((at - self.systole) / self.relaxation, 0.0, 1.0)
        return (np.cos(np.pi * fall) - np.cos(np.pi * rise)) / 2


@dataclass(frozen=True)
class GammaVariate(Signal):
    """Inflow and washout of a contrast agent.

    Parameters
    ----------
    arrival : time before which there is none [s]
    rise : from arrival to the peak [s]
    shape : power, larger for a narrower peak

    References
    ----------
    Madsen 1992, Physics in Medicine and Biology 37, 1597, doi:10.1088/0031-9155/37/7/010.
    """

    arrival: float
    rise: float
    shape: float = 3.0

    def values(self, times: Times) -> Times:
        """Compute the concentration relative to its peak.

        Parameters
        ----------
        times : [s]

        Returns
        -------
        values from 0 to 1
        """
        x = np.maximum((times - self.arrival) / self.rise, 0.0)
        return (x * np.exp(1 - x)) ** self.shape


@dataclass(frozen=True)
class Table(Signal):
    """Values at given times, linear between them.

    Parameters
    ----------
    at : ascending times [s]
    given : values
    period : after which the table repeats [s]; None where it does not, and is constant outside

    Raises
    ------
    InputError
        When the times do not ascend, are not as many as the values, or do not fit into the period.
    """

    at: tuple[float, ...]
    given: tuple[float, ...]
    period: float | None = None

    def __post_init__(self) -> None:
        if len(self.at) != len(self.given):
            raise InputError(f"times and values must be equally many, got {len(self.at)} and {len(self.given)}")
        if not (np.diff(self.at) > 0).all():
            raise InputError("times of a signal must ascend")
        if self.period is not None and self.at[-1] - self.at[0] >= self.period:
            raise InputError(
                f"times of a signal span {self.at[-1] - self.at[0]:g} s, which must be less than its period of "
                f"{self.period:g} s"
            )

    def values(self, times: Times) -> Times:
        """Interpolate.

        Parameters
        ----------
        times : [s]

        Returns
        -------
        values
        """
        return np.interp(times, self.at, self.given, period=self.period)

    def cycles(self, times: Times) -> Times | None:
        """Compute the position in the cycle.

        Parameters
        ----------
        times : [s]

        Returns
        -------
        positions from 0, at the first time, to 1; None without a period
        """
        return None if self.period is None else (times - self.at[0]) / self.period % 1.0
