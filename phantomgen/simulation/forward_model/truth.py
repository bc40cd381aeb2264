"""Exact voxel truth of a scan, whole or in slabs, and of its phases where objects move or materials change."""

from collections.abc import Callable
from functools import lru_cache, partial

import numpy as np
from jaxtyping import Float32

from phantomgen.dataset.truth import PhaseFractions, StreamedTruth, Truth
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.scene.scan import Scan
from phantomgen.scene.scene_objects import SceneObjects
from phantomgen.simulation.forward_model.energy_grids import (
    material_coefficients,
    material_fit,
)

# Instants of each phase, at views spread evenly over it, whose mean is its truth.
_INSTANTS = 3
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
    coefficients, fit = material_coefficients(scan), material_fit(scan)
    phases = _phases(scan)

    whole = fractions_on or scan.scene.fractions
    return StreamedTruth(scan.grid, scan.basis.names, names, coefficients, whole, scan.text, fit, phases)


def _phases(scan: Scan) -> tuple[PhaseFractions, ...]:
    """Phases of a scan with their parts of its training views: one where they are not divided, none where all rests.

    Where objects rest and materials change, the objects are voxelized once for all phases.
    """
    dynamics, train = scan.dynamics, scan.splits["train"]
    if dynamics is None:
        return ()
    of_view = dynamics.phase_of_view
    numbers = np.zeros(len(train), np.int64) if of_view is None else of_view[train]
    filled = None if any(dynamics.motions) else lru_cache(maxsize=1)(scan.scene.fractions)
    phases = []
    for phase in range(int(numbers.max()) + 1):
        own = dynamics.in_order(train[numbers == phase])
        if len(own):
            count = min(len(own), _INSTANTS)
            some = own[((np.arange(count) + 0.5) / count * len(own)).astype(int)]
            instants = [scan.instant(view).scene for view in some.tolist()]
            mean = _mean_fractions if filled is None else partial(_mean_mixture, filled)
            phases.append(PhaseFractions(len(own) / len(train), partial(mean, instants)))
    return tuple(phases)


def _mean_fractions(instants: list[SceneObjects], grid: Grid) -> Float32[np.ndarray, "material z y x"]:
    """Mean of the material fractions over some instants."""
    total = np.zeros((len(instants[0].materials), *grid.shape), np.float32)
    for instant in instants:
        total += instant.fractions(grid)
    return total / np.float32(len(instants))


def _mean_mixture(
    filled: FractionsOnGrid, instants: list[SceneObjects], grid: Grid
) -> Float32[np.ndarray, "material z y x"]:
    """Mean of the material fractions over some instants between which materials change only."""
    mixings = [instant.mixing for instant in instants if instant.mixing is not None]
    rest = filled(grid)
    return np.tensordot(np.mean(mixings, axis=0).T.astype(np.float32), rest, axes=1) if mixings else rest
