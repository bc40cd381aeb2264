"""Projections of a scan for other programs: what every exporter of scans takes."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float, Shaped

from phantomgen.geometry.flat_panel import flat_equivalent, on_flat_panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from spectra.errors import InputError

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

    def watched(self, on_view: Callable[[], object]) -> "Projections":
        """Tell when images of a view were computed for the first time.

        Parameters
        ----------
        on_view : called after each view

        Returns
        -------
        the projections
        """
        seen: set[int] = set()

        def image(view: int) -> Shaped[np.ndarray, "name row column"]:
            found = self.image(view)
            if view not in seen:
                seen.add(view)
                on_view()
            return found

        return replace(self, image=image)

    def on_flat_panel(self) -> "Projections":
        """Resample line integrals of a curved panel to the flat panel that touches it in its middle.

        Returns
        -------
        the projections; themselves where the panel is flat

        Raises
        ------
        InputError
            When they are counts, whose noise would not be that of counts any more.
        """
        curved, flat = self.geometry, flat_equivalent(self.geometry)
        if flat is curved:
            return self
        if self.kind != "line-integrals":
            raise InputError("counts of a curved panel are not resampled to a flat one: line integrals can be")

        def image(view: int) -> Shaped[np.ndarray, "name row column"]:
            return on_flat_panel(self.image(view)[None], curved[[view]], flat[[view]])[0][0]

        return replace(self, geometry=flat, image=image)
