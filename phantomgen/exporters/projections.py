"""Projections of a scan for other programs: what every exporter of scans takes."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float, Shaped

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid

Kind = Literal["line-integrals", "counts"]


@dataclass(frozen=True, eq=False)
class Projections:
    """Images of all views, which are computed when they are written.

    Parameters
    ----------
    title : of the scan
    kind : line integrals without unit, or counts
    names : of the channels, or of the basis functions of decomposed projections
    geometry : poses of the views, those for training first
    train : number of views for training
    grid : voxels of the volume to reconstruct
    image : returns the images of a view by its place in `geometry`
    energies : effective energy of each channel [keV]; NaN where there is none
    flats, darks : frames of open beam and without beam, of counts only
    exposure : of each view and channel relative to the flats, of counts only
    volumes : true attenuation at the energies, or true basis volumes [1/mm]; None where the truth is not known
    """

    title: str
    kind: Kind
    names: tuple[str, ...]
    geometry: Geometry
    train: int
    grid: Grid
    image: Callable[[int], Shaped[np.ndarray, "name row column"]]
    energies: tuple[float, ...]
    flats: Shaped[np.ndarray, "flat name row column"] | None = None
    darks: Shaped[np.ndarray, "dark name row column"] | None = None
    exposure: Float[np.ndarray, "view name"] | None = None
    volumes: Callable[[int], Float[np.ndarray, "z y x"]] | None = None

    def __len__(self) -> int:
        return len(self.geometry)

    def __repr__(self) -> str:
        return f"Projections({self.title}: {self.kind} of {', '.join(self.names)}, {len(self)} views)"

    def training(self) -> "Projections":
        """Return the views for training.

        Returns
        -------
        the projections
        """
        exposure = None if self.exposure is None else self.exposure[: self.train]
        return replace(self, geometry=self.geometry[: self.train], exposure=exposure)
