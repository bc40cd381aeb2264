"""What the reconstructor sees: counts, open beam, geometry and the spectral model of some of the views."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from phantomgen.geometry import Geometry
from spectra.transmission import Transmission


@dataclass(frozen=True, eq=False)
class Measurements:
    """Counts and what is known about how they came about.

    Parameters
    ----------
    counts : measured counts minus dark, float32
    gains : open-beam counts of each pixel over those that `transmission` expects, float32
    exposure : tube output of each view relative to the flat frames
    geometry : poses of the views
    transmission : columns are the basis functions
    """

    counts: Float[np.ndarray, "view channel row column"]
    gains: Float[np.ndarray, "channel row column"]
    exposure: Float[np.ndarray, " view"]
    geometry: Geometry
    transmission: Transmission

    def __len__(self) -> int:
        return len(self.counts)

    def __getitem__(self, views: slice | list[int] | np.ndarray) -> "Measurements":
        """Some of the views."""
        return Measurements(
            self.counts[views], self.gains, self.exposure[views], self.geometry[views], self.transmission
        )

    def binned(self, factor: int) -> "Measurements":
        """The same scan with `factor` x `factor` pixels summed into one."""
        if factor == 1:
            return self
        geometry = self.geometry.binned(factor)
        return Measurements(
            _sum_blocks(self.counts, factor),
            _sum_blocks(self.gains, factor),
            self.exposure,
            geometry,
            self.transmission,
        )


def _sum_blocks(images: Float[np.ndarray, "... row column"], factor: int) -> Float[np.ndarray, "... row column"]:
    *front, rows, columns = images.shape
    return images.reshape(*front, rows // factor, factor, columns // factor, factor).sum(axis=(-3, -1))
