"""Detectors by a table: counts per incident photon, measured or simulated elsewhere.

Rows belong to energies of incident photons, between which counts are interpolated linearly. Rows may sum to more than
1, where a photon counts in several pixels, and nothing normalises them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from spectra.detector.detector import AnyDetector, channels_between
from spectra.energy.grid import Energies
from spectra.errors import InputError

# Spacings of deposited energies that differ by less than this part are equal.
_EVEN = 1e-6


@dataclass(frozen=True, eq=False)
class ResponseMatrix(AnyDetector):
    """Photon-counting detector whose response is a table.

    Parameters
    ----------
    energy : incident energies of the table, ascending [keV]
    counts : counts of each channel per incident photon of each energy, absorption included
    """

    energy: Float[np.ndarray, " row"]
    counts: Float[np.ndarray, "row channel"]

    def __post_init__(self) -> None:
        _check_energies("incident", self.energy)
        _check_matrix(self.counts, len(self.energy), len(self.channels), "channels")
        if self.energy[-1] < self.channels[-1].upper:
            raise InputError(
                f"the response matrix ends at {self.energy[-1]:g} keV, but the source at "
                f"{self.channels[-1].upper:g} keV"
            )

    @classmethod
    def of_channels(
        cls,
        energy: Float[np.ndarray, " row"],
        matrix: Float[np.ndarray, "row channel"],
        thresholds: Sequence[float],
        top: float,
    ) -> "ResponseMatrix":
        """Create a detector from a table with a column for each channel.

        Parameters
        ----------
        energy : of incident photons [keV]
        matrix : counts per incident photon
        thresholds : nominal lower limit of each channel [keV]
        top : highest energy of the source [keV]

        Returns
        -------
        the detector
        """
        return cls(channels_between(thresholds, top), np.asarray(energy, float), np.asarray(matrix, float))

    @classmethod
    def of_deposited(
        cls,
        energy: Float[np.ndarray, " row"],
        deposited: Float[np.ndarray, " column"],
        matrix: Float[np.ndarray, "row column"],
        thresholds: Sequence[float],
        top: float,
        per_keV: bool = False,
    ) -> "ResponseMatrix":
        """Create a detector from a table with a column for each bin of deposited energy.

        The bins have equal widths. Counts of a bin that a threshold cuts are split in proportion.

        Parameters
        ----------
        energy : of incident photons [keV]
        deposited : middle of each bin [keV]
        matrix : pulses per incident photon and bin, or per keV
        thresholds : lower limit of each channel [keV]
        top : highest energy of the source [keV]
        per_keV : whether the matrix holds a density

        Returns
        -------
        the detector
        """
        energy, deposited, matrix = (np.asarray(x, float) for x in (energy, deposited, matrix))
        _check_energies("incident", energy)
        width = _bin_width(deposited)
        _check_matrix(matrix, len(energy), len(deposited), "deposited energies")
        channels = channels_between(thresholds, top)
        above = np.stack([np.clip((deposited + width / 2 - t) / width, 0.0, 1.0) for t in thresholds])
        share = above - np.append(above[1:], np.zeros((1, len(deposited))), axis=0)
        return cls(channels, energy, matrix @ share.T * (width if per_keV else 1.0))

    @property
    def lowest(self) -> float:
        """Energy where the table begins to count [keV]; photons below are not measured."""
        first = int(np.argmax(self.counts.any(axis=1)))
        return float(self.energy[max(first - 1, 0)])

    @property
    def breaks(self) -> tuple[float, ...]:
        """Energies of the table, where the interpolation has kinks [keV]."""
        return tuple(self.energy[(self.energy > self.lowest) & (self.energy < self.channels[-1].upper)].tolist())

    def response(self, energies: Energies) -> Float[np.ndarray, "channel energy"]:
        """Compute the counts of each channel per incident photon of each bin; 0 below the table.

        Parameters
        ----------
        energies : energy bins

        Returns
        -------
        counts per photon, (channel, energy)
        """
        return np.stack([np.interp(energies.nodes, self.energy, column, left=0.0) for column in self.counts.T])


def _check_energies(kind: str, energy: Float[np.ndarray, " n"]) -> None:
    """Refuse energies that are no axis."""
    if energy.ndim != 1 or len(energy) < 2 or not np.isfinite(energy).all() or energy[0] < 0:
        raise InputError(f"a response matrix needs at least two finite {kind} energies, none negative")
    falls = np.flatnonzero(np.diff(energy) <= 0)
    if len(falls):
        before, after = energy[falls[0]], energy[falls[0] + 1]
        raise InputError(f"{kind} energies of a response matrix must ascend, but {after:g} follows {before:g} keV")


def _bin_width(deposited: Float[np.ndarray, " column"]) -> float:
    """Common width of the bins of deposited energy [keV]."""
    _check_energies("deposited", deposited)
    widths = np.diff(deposited)
    if np.ptp(widths) > _EVEN * widths[0] + 1e-9:
        raise InputError(
            "deposited energies of a response matrix must be evenly spaced, but their steps are from "
            f"{widths.min():g} to {widths.max():g} keV"
        )
    return float(widths.mean())


def _check_matrix(matrix: np.ndarray, rows: int, columns: int, what: str) -> None:
    """Refuse shapes that do not fit, and values that are no counts."""
    if matrix.shape != (rows, columns):
        hint = ": is it transposed?" if matrix.shape == (columns, rows) else ""
        raise InputError(
            f"the response matrix has shape {matrix.shape}, expected {(rows, columns)}, incident energies x {what}"
            f"{hint}"
        )
    bad = ~np.isfinite(matrix) | (matrix < 0)
    if bad.any():
        row, column = np.argwhere(bad)[0].tolist()
        raise InputError(
            f"values of a response matrix must be finite and not negative, got {matrix[row, column]:g} in row {row}, "
            f"column {column}, counted from 0"
        )
