"""Filtered back-projection of one channel with a water correction, as clinical scanners have it.

The logarithm of the counts of a ray is replaced by the length of water that attenuates as much, times the attenuation
of water at one energy. An object of water is free of beam hardening then; bone and metal are not.

References
----------
Joseph & Spital 1978, doi:10.1097/00004728-197801000-00017: the correction, and the errors that it leaves.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.voxel_grid import Grid
from recon.data.measurements import Measurements, matching_bin
from recon.voxel.filtered.fdk import fdk
from recon.voxel.image_domain import log_projections
from recon.voxel.method import Iteration, OnIteration, Volumes, no_callback
from spectra.errors import InputError
from spectra.materials.material_curve import MaterialCurve

# mm of water; from below 0, where noise puts rays beside the object, to more than any ray passes; interpolation between
# the entries errs by less than 1e-6 of a log projection
LENGTHS = np.arange(-20.0, 5000.0, 0.5)
WINDOW = "cosine"  # of the ramp filter, as for `recon.voxel.filtered.fdk.Fdk`


@dataclass(frozen=True)
class FdkWater:
    """Filtered back-projection of one channel with a water correction.

    Parameters
    ----------
    curve : materials of the object, water among them; they turn the attenuation at the energy of the curve, which is
        what this method finds, into coefficients of the bases
    """

    curve: MaterialCurve | None = None

    @property
    def name(self) -> str:
        """Name of the method, as in ``--method``."""
        return "fdk-water"

    def reconstruct_counts(
        self, measurements: Measurements, grid: Grid, on_iteration: OnIteration = no_callback
    ) -> Volumes:
        """Reconstruct volumes from the counts of one channel.

        Parameters
        ----------
        measurements : views of a circular orbit, unbinned
        grid : the volume to reconstruct
        on_iteration : called once

        Returns
        -------
        volumes of the bases [1/mm]
        """
        curve = known(self.curve, self.name)
        lines, data = lines_of_water(measurements, grid, curve)
        volumes = curve.values(np.maximum(filtered(lines, data, grid), 0))
        on_iteration(Iteration(1, 1, None, volumes))
        return volumes


def known(curve: MaterialCurve | None, method: str) -> MaterialCurve:
    """Refuse a method without a curve of materials, or whose curve lacks water.

    Parameters
    ----------
    curve : the curve
    method : name of the method, for the message

    Returns
    -------
    the curve

    Raises
    ------
    InputError
        When there is none, or water is not in it.
    """
    if curve is None or "water" not in curve.materials:
        raise InputError(f"the method {method} needs a curve of materials with water: add --bases curve")
    return curve


def lines_of_water(
    measurements: Measurements, grid: Grid, curve: MaterialCurve
) -> tuple[Float[np.ndarray, "view row column"], Measurements]:
    """Correct the log projections of the first channel for the hardening of the beam in water.

    Parameters
    ----------
    measurements : counts, unbinned
    grid : voxels that pixels are binned to match
    curve : of materials, with water

    Returns
    -------
    line integrals of the attenuation of water at the energy of the curve [no unit], and the binned counts
    """
    data = measurements.completed().binned(matching_bin(measurements.geometry, min(grid.spacing)))
    at = curve.materials.index("water")
    fixed = np.zeros(0) if data.profile is None else data.profile.mean(axis=(1, 2))
    lengths = np.concatenate([np.outer(LENGTHS, curve.coefficients[at]), np.tile(fixed, (len(LENGTHS), 1))], axis=1)
    open_beam = np.concatenate([np.zeros(len(curve.coefficients[at])), fixed])
    table, air = (data.transmission.log_projection_and_slopes(each)[0][..., 0] for each in (lengths, open_beam))
    logs = log_projections(data)[0]
    return (curve.attenuations[at] * np.interp(logs, table - air, LENGTHS)).astype(np.float32), data


def filtered(lines: Float[np.ndarray, "view row column"], data: Measurements, grid: Grid) -> Float[np.ndarray, "z y x"]:
    """Back-project line integrals of one quantity.

    Parameters
    ----------
    lines : line integrals [no unit]
    data : measurements with the poses of the views
    grid : the volume to reconstruct

    Returns
    -------
    the volume [1/mm]
    """
    return fdk(lines[:, None], data.geometry, grid, WINDOW)[0]
