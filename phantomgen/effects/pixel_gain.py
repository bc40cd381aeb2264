"""Sensitivity that differs from pixel to pixel, and leaves rings where flats do not take it away.

Model: a pixel of a channel registers g times the signal that falls on it. In flats

    g = 1 + sigma N(row, column) + columns N(column) + smooth F(row, column),

with independent normal numbers N and a smooth pattern F, random cosines of up to three half periods along each axis
with rms 1. In views it is g (1 + drift N'(row, column)): a detector that has changed since its flats were taken. The
patterns belong to the seed and are the same in all frames. Counters register g times as many photons, so that noise
follows; in detectors that integrate energy the amplifier of the pixel scales signal and noise alike (cascade of gains:
Cunningham & Shaw 1999, doi:10.1364/JOSAA.16.000621).
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float

from phantomgen.effects.random_streams import Stream, generator
from spectra.errors import InputError

# Largest standard deviation of gains, no unit; half periods of the smooth map along each edge of the panel, at most.
_LARGEST = 0.2
_HALF_PERIODS = 3
_MAP, _DRIFT = 0, 1  # in the place of a frame in keys

Image = Float[np.ndarray, "row column"]


@dataclass(frozen=True)
class Gain:
    """Gain map of pixels: relative standard deviations, each at most 0.2.

    Parameters
    ----------
    sigma : of every pixel on its own
    columns : of every column
    smooth : of a smooth pattern over the panel
    drift : of the change between flats and views
    in_flats : whether flats show the map; if not, it stays in the views

    Raises
    ------
    InputError
        When one is negative or so large that a gain may be negative.
    """

    sigma: float = 0.0
    columns: float = 0.0
    smooth: float = 0.0
    drift: float = 0.0
    in_flats: bool = True

    def __post_init__(self) -> None:
        for name in ("sigma", "columns", "smooth", "drift"):
            if not 0 <= getattr(self, name) <= _LARGEST:
                raise InputError(f"the {name} of a gain map must lie in 0 .. {_LARGEST}, got {getattr(self, name):g}")

    def maps(
        self, seed: int, channels: int, rows: int, columns: int, stream: Stream = Stream.PROJECTION
    ) -> Float[np.ndarray, "channel row column"]:
        """Compute the gain of every pixel in views, or in flats.

        The map of a channel does not depend on the number of channels.

        Parameters
        ----------
        seed : of the scan
        channels, rows, columns : their numbers
        stream : views or flats

        Returns
        -------
        gains, (channel, row, column)
        """
        return np.stack([self._map(seed, channel, rows, columns, stream) for channel in range(channels)])

    def _map(self, seed: int, channel: int, rows: int, columns: int, stream: Stream) -> Image:
        """Gain of one channel."""
        random = generator(seed, Stream.GAIN, _MAP, channel)
        gain = 1 + self.sigma * random.standard_normal((rows, columns))
        gain += self.columns * random.standard_normal(columns)
        gain += self.smooth * _smooth(random, rows, columns)
        if stream is Stream.FLAT:
            return np.maximum(gain, 0.0) if self.in_flats else np.ones((rows, columns))
        changed = generator(seed, Stream.GAIN, _DRIFT, channel).standard_normal((rows, columns))
        return np.maximum(gain * (1 + self.drift * changed), 0.0)


def _smooth(random: np.random.RandomState, rows: int, columns: int) -> Image:
    """A random sum of the slowest cosines over the panel, with rms 1; zero on a panel of one pixel."""
    along_rows, along_columns = (_cosines(count) for count in (rows, columns))
    pattern = np.zeros((rows, columns))
    for i, j in product(range(_HALF_PERIODS + 1), repeat=2):
        weight = random.standard_normal()
        if i or j:
            pattern += weight * np.outer(along_rows[i], along_columns[j])
    pattern -= pattern.mean()
    size = np.sqrt(np.mean(pattern**2))
    return pattern / size if size > 1e-9 else np.zeros_like(pattern)


def _cosines(count: int) -> Float[np.ndarray, "order pixel"]:
    """cos(pi i x) at the pixel centres of an axis of unit length."""
    return np.cos(np.pi * np.outer(np.arange(_HALF_PERIODS + 1), (np.arange(count) + 0.5) / count))
