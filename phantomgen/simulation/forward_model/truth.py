"""Exact voxel truth of a scan, whole or in slabs."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float32

from phantomgen.dataset.truth import StreamedTruth, Truth
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.voxelize_shapes import fractions
from phantomgen.scene.scan import Scan
from phantomgen.simulation.forward_model.energy_grids import (
    material_coefficients,
    material_fit,
)

# From a grid to the part of each voxel that each material fills.
FractionsOnGrid = Callable[[Grid], Float32[np.ndarray, "material z y x"]]


def scan_truth(scan: Scan) -> Truth:
    """Compute material fractions and basis volumes of the whole grid.

    Parameters
    ----------
    scan : what is simulated

    Returns
    -------
    the truth
    """
    return streamed_truth(scan).part(scan.grid)


def streamed_truth(scan: Scan, fractions_on: FractionsOnGrid | None = None) -> StreamedTruth:
    """Create the truth slab by slab, for volumes that are larger than memory.

    Parameters
    ----------
    scan : what is simulated
    fractions_on : function that returns the material fractions of a grid where these are known

    Returns
    -------
    the truth
    """
    names = tuple(m.name for m in scan.scene.materials)
    solids, background = scan.scene.solids, scan.scene.background
    coefficients, fit = material_coefficients(scan), material_fit(scan)

    def voxelized(grid: Grid) -> Float32[np.ndarray, "material z y x"]:
        return fractions(grid, solids, len(names), background=background)

    return StreamedTruth(scan.grid, scan.basis.names, names, coefficients, fractions_on or voxelized, scan.text, fit)
