"""Afterglow: a part of every signal shows in later views.

Model, linear and time-invariant with several exponentials (Hsieh, Gurmen & King 2000, IEEE Trans. Med. Imaging 19, 930;
Starman et al. 2012, Med. Phys. 39, 6035): of the signal s of view n the part f_i is stored and decays with a time
constant of tau_i views. With e_i = exp(-1 / tau_i)

    measured_n = sum_k h_k s_{n-k},   h_0 = 1 - sum_i f_i,   h_k = sum_i f_i (1 - e_i) e_i^(k-1) for k >= 1.

All of the signal shows at some time, sum_k h_k = 1. It acts on signals with their photon noise, before the electronics.
An acquisition begins with nothing stored; training and test views are acquisitions of their own. Flats are taken when
storing and release balance, and have none.
"""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from spectra.errors import InputError

# Largest sum of the fractions of a signal that come later, no unit.
_MOST = 0.9

Frame = Float[np.ndarray, "channel row column"]
Stored = Float[np.ndarray, "term channel row column"]


@dataclass(frozen=True)
class Lag:
    """Afterglow: parts of a signal that are stored, and their time constants.

    Parameters
    ----------
    fractions : of the signal that each exponential stores; together at most 0.9
    decays : time constant of each exponential [view]

    Raises
    ------
    InputError
        When there are not as many of these as of those, or a number is out of its range.
    """

    fractions: tuple[float, ...]
    decays: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.fractions) != len(self.decays) or not self.fractions:
            raise InputError(
                f"lag needs a decay for each fraction, got {len(self.fractions)} fractions, {len(self.decays)} decays"
            )
        if min(self.fractions) < 0 or not sum(self.fractions) <= _MOST:
            raise InputError(
                f"the fractions of lag must not be negative and sum up to at most {_MOST}, got {self.fractions}"
            )
        if not all(0 < decay < np.inf for decay in self.decays):
            raise InputError(f"the decays of lag must be positive and finite, in views, got {self.decays}")

    @property
    def kept(self) -> Float[np.ndarray, " term"]:
        """Part of each store that is left after one view, e_i."""
        return np.exp(-1 / np.array(self.decays))

    def response(self, views: int) -> Float[np.ndarray, " view"]:
        """Compute h_k, the response to the signal of one view in this view and in those after it.

        Parameters
        ----------
        views : number of views

        Returns
        -------
        parts of the signal
        """
        later = np.arange(1, views)[:, None]
        parts = np.array(self.fractions) * (1 - self.kept) * self.kept ** (later - 1)
        return np.append(1 - sum(self.fractions), parts.sum(axis=1))[:views]

    def memory(self, tail: float) -> int:
        """Return the number of views after which less than `tail` of a signal is still stored.

        Parameters
        ----------
        tail : part of a signal

        Returns
        -------
        number of views
        """
        slowest = max(self.decays)
        return max(int(np.ceil(slowest * np.log(sum(self.fractions) / tail))), 1) if sum(self.fractions) > tail else 1

    def empty(self, shape: tuple[int, ...]) -> Stored:
        """Return the state with nothing stored.

        Parameters
        ----------
        shape : shape of a frame

        Returns
        -------
        zeros, (term, *shape)
        """
        return np.zeros((len(self.decays), *shape))

    def read(self, signal: Frame, stored: Stored) -> tuple[Frame, Stored]:
        """Compute the measured signal, and the state after it.

        Parameters
        ----------
        signal : signal of a view
        stored : state before it

        Returns
        -------
        measured signal, and new state
        """
        signal = np.asarray(signal, dtype=np.float64)
        kept, fractions = (np.reshape(x, (-1, 1, 1, 1)) for x in (self.kept, self.fractions))
        measured = (1 - sum(self.fractions)) * signal + ((1 - kept) * stored).sum(axis=0)
        return measured, kept * stored + fractions * signal

    def first_needed(self, view: int, starts: Collection[int], tail: float = 0.0) -> int:
        """Return the view to begin with, nothing stored, so that all is right from `view` on.

        Parameters
        ----------
        view : to go on from
        starts : views with which an acquisition begins
        tail : part of a signal that may be forgotten; 0 begins with the acquisition and gives every bit

        Returns
        -------
        number of the view
        """
        first = max((start for start in starts if start <= view), default=0)
        return max(first, view - self.memory(tail)) if tail > 0 else first
