"""Dose of a scan in each voxel of its scene."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from phantomgen.dose.beam import ScanBeam
from phantomgen.dose.run import JOULE, follow_scan, masses
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.scene.scan import Scan
from spectra.errors import InputError

_PURE = 0.99  # no unit; least part of a voxel's mass that is of a material where the dose of that material is summed
_LIGHT = 0.01  # g/cm^3; voxels of less have no dose


@dataclass(frozen=True, eq=False)
class DoseMap:
    """Dose in voxels.

    Parameters
    ----------
    grid : the voxels
    dose : absorbed dose, by kerma; 0 in voxels without mass [Gy]
    error : standard error of `dose` [Gy]
    materials : mean dose of each material [Gy] and its mass [kg], over voxels of it alone
    energy : imparted to all voxels [J]
    absorbed : part of the energy of all photons of the scan
    """

    grid: Grid
    dose: Float[np.ndarray, "z y x"]
    error: Float[np.ndarray, "z y x"]
    materials: dict[str, tuple[float, float]]
    energy: float
    absorbed: float

    @property
    def typical_error(self) -> float:
        """Median relative error of voxels with at least half of the largest dose of the 99th percentile."""
        inside = self.dose > 0.5 * np.percentile(self.dose[self.dose > 0], 99)
        return float(np.median(self.error[inside] / self.dose[inside]))


def dose_map(scan: Scan, photons: int, voxels: int, seed: int, title: str | None = None) -> DoseMap:
    """Compute the dose map of a scan.

    Parameters
    ----------
    scan : the scan
    photons : that are followed
    voxels : along the longest edge of the volume of the scan, which the map covers
    seed : of their random numbers
    title : of a progress bar; None for none

    Returns
    -------
    dose in each voxel

    Raises
    ------
    InputError
        When a material has no composition, or nothing is in the volume.
    """
    grid, materials = resampled(scan.grid, voxels), scan.scene.materials
    beam = ScanBeam.of(scan)
    filled = scan.scene.fractions(grid)
    used = np.flatnonzero(filled.reshape(len(materials), -1).any(axis=1))
    if not len(used):
        raise InputError(f"the volume of {scan.name} holds no object that could take a dose")
    materials, filled = tuple(materials[i] for i in used), filled[used]
    found = follow_scan(beam, materials, filled, grid, photons, seed, title=title)
    mass = masses(materials, filled, grid)
    heavy = mass > _LIGHT * 1e-6 * float(np.prod(grid.spacing))
    gray = np.where(heavy, JOULE / np.where(heavy, mass, 1.0), 0.0)
    means = {}
    for material, part in zip(materials, filled, strict=True):
        own = masses((material,), part[None], grid)
        pure = (own > _PURE * mass) & heavy
        if pure.any():
            weight = float(mass[pure].sum())
            means[material.name] = (float(found.voxels[pure].sum()) * JOULE / weight, weight)
    energy = float(found.voxels.sum()) * JOULE
    return DoseMap(grid, found.voxels * gray, found.voxel_errors * gray, means, energy, found.absorbed)


def resampled(grid: Grid, voxels: int) -> Grid:
    """Return a grid over the same volume with other voxels.

    Parameters
    ----------
    grid : the grid
    voxels : along its longest edge

    Returns
    -------
    grid whose voxels are nearly cubes
    """
    edges = np.array(grid.shape) * np.array(grid.spacing)
    count = np.maximum(np.round(edges / (edges.max() / voxels)), 1).astype(int)
    spacing = edges / count
    first = np.array(grid.origin) - np.array(grid.spacing) / 2 + spacing / 2
    a, b, c = ((int(count[i]), float(spacing[i]), float(first[i])) for i in range(3))
    return Grid((a[0], b[0], c[0]), (a[1], b[1], c[1]), (a[2], b[2], c[2]))
