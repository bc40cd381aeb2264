"""Normalised metal artefact reduction (NMAR) for one channel.

Rays through metal are replaced: the projections are divided by those of a prior image without metal, interpolated along
the rows of the panel across the shadow of the metal, and multiplied again. Quotients are nearly flat, so that edges of
bone survive. Metal is put back from the first image.

References
----------
Meyer et al. 2010, doi:10.1118/1.3484090. Thresholds of the prior image are those of a scan corrected for water.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter

from phantomgen.geometry.voxel_grid import Grid
from recon.data.measurements import Measurements
from recon.voxel.iterative.likelihood import forward
from recon.voxel.method import Iteration, OnIteration, Volumes, no_callback
from recon.voxel.one_channel.water_correction import filtered, known, lines_of_water
from spectra.materials.material_curve import MaterialCurve


@dataclass(frozen=True)
class Nmar:
    """Normalised metal artefact reduction with a water correction; values over water are chosen by hand.

    Parameters
    ----------
    curve : materials of the object, water among them, see `recon.voxel.one_channel.water_correction.FdkWater`
    metal : attenuation of the thinnest metal over that of water; 4 is 3000 HU
    bone : attenuation above which the prior image keeps what the first image has; 1.3 is 300 HU
    air : attenuation below which the prior image is empty; 0.5 is -500 HU
    blur : standard deviation of the Gaussian that the first image is smoothed by before its prior image [voxels]
    least : line integral of the prior image that quotients are taken over, at least [no unit]
    """

    curve: MaterialCurve | None = None
    metal: float = 4.0
    bone: float = 1.3
    air: float = 0.5
    blur: float = 1.0
    least: float = 0.05

    @property
    def name(self) -> str:
        """Name of the method, as in ``--method``."""
        return "nmar"

    def reconstruct_counts(
        self, measurements: Measurements, grid: Grid, on_iteration: OnIteration = no_callback
    ) -> Volumes:
        """Reconstruct volumes from the counts of one channel.

        Parameters
        ----------
        measurements : views of a circular orbit, unbinned
        grid : the volume to reconstruct
        on_iteration : called after the first image and after the last

        Returns
        -------
        volumes of the bases [1/mm]
        """
        curve = known(self.curve, self.name)
        water = curve.attenuations[curve.materials.index("water")]
        lines, data = lines_of_water(measurements, grid, curve)
        first = filtered(lines, data, grid)
        on_iteration(Iteration(1, 2, None, curve.values(np.maximum(first, 0))))
        metal = first > self.metal * water
        if metal.any():
            without = self._without_metal(lines, data, grid, self._prior(first, metal, water), metal)
            first = np.where(metal, first, filtered(without, data, grid))
        volumes = curve.values(np.maximum(first, 0))
        on_iteration(Iteration(2, 2, None, volumes))
        return volumes

    def _prior(
        self, first: Float[np.ndarray, "z y x"], metal: Bool[np.ndarray, "z y x"], water: float
    ) -> Float[np.ndarray, "z y x"]:
        """The first image, smoothed, with soft tissue and metal set to water, and air to 0."""
        smooth = gaussian_filter(np.where(metal, water, first), self.blur)
        prior = np.where(smooth > self.bone * water, smooth, water)
        prior[smooth < self.air * water] = 0
        prior[metal] = water
        return prior.astype(np.float32)

    def _without_metal(
        self,
        lines: Float[np.ndarray, "view row column"],
        data: Measurements,
        grid: Grid,
        prior: Float[np.ndarray, "z y x"],
        metal: Bool[np.ndarray, "z y x"],
    ) -> Float[np.ndarray, "view row column"]:
        """Line integrals in which those through metal are interpolated."""
        both = np.stack([prior, metal.astype(np.float32)])
        expected, length = forward(both, data.geometry, grid)
        shadow = length > 0
        quotients = lines / np.maximum(expected, self.least)
        columns = np.arange(lines.shape[2])
        for view, row in zip(*np.nonzero(shadow.any(axis=2)), strict=True):
            hidden = shadow[view, row]
            if not hidden.all():
                quotients[view, row, hidden] = np.interp(
                    columns[hidden], columns[~hidden], quotients[view, row, ~hidden]
                )
        return np.where(shadow, quotients * np.maximum(expected, self.least), lines).astype(np.float32)
