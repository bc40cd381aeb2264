"""How wide a margin around truncated views must be, from how well voxels in it explain the counts.

`recon.data.coverage` takes the object for round and even. One that is not, as a second object beside the field of view,
goes on beyond that, and what attenuates rays there has no voxel. Too wide a margin is no better: what lies in it is
hardly known, and bases exchange low frequencies with the field of view. Coarse voxels are fitted in wider and wider
ones. Where the first one leaves several times the least misfit, the narrowest is taken that comes close to that.
"""

from dataclasses import replace

import numpy as np

from phantomgen.geometry.voxel_grid import Grid
from recon.data.coverage import LARGEST, Coverage, border_distances, grown_to
from recon.data.measurements import Measurements
from recon.voxel.iterative.one_step import OneStep
from recon.voxel.method import Iteration

WIDER = 1.15  # times the width before
CONTRADICTED = 3.0  # times the least misfit; a margin with less stays, as wider ones cost Compton more than they mend
CLOSE = 1.4  # times the least misfit; coarse voxels do not tell smaller differences from their own errors
COARSE = OneStep(levels=((4, 8), (2, 8)))


def with_margin_found(measured: Measurements, covered: Coverage) -> Coverage:
    """Coverage whose grid is wide enough for what truncated views see; as it was where none is truncated laterally.

    Parameters
    ----------
    measured : the scan, without partial volume
    covered : what `recon.data.coverage.coverage` found
    """
    grids = margins(measured, covered)
    if len(grids) == 1:
        return covered
    misfits = [_misfit(measured, grid) for grid in grids]
    if misfits[0] <= CONTRADICTED * min(misfits):
        return covered
    close = next(i for i, misfit in enumerate(misfits) if misfit <= CLOSE * min(misfits))
    return replace(covered, grid=grids[close])


def margins(measured: Measurements, covered: Coverage) -> list[Grid]:
    """The grid of a coverage, and wider ones, up to where `recon.data.coverage` would end the object."""
    if not covered.lateral:
        return [covered.grid]
    grid, grids = covered.grid, [covered.grid]
    faces = [abs(grid.axis(name)[end]) + grid.spacing[2 - "xyz".index(name)] / 2 for name in "xy" for end in (0, -1)]
    low, high = (grid.axis("z")[end] + sign * grid.spacing[0] / 2 for end, sign in ((0, -1), (-1, 1)))
    radius, largest = max(faces), LARGEST * float(np.median(border_distances(measured.geometry).max(axis=1)))
    while (radius := WIDER * radius) <= largest:
        wider = grown_to(grid, radius, (low, high))
        if wider != grids[-1]:
            grids.append(wider)
    return grids


def _misfit(measured: Measurements, grid: Grid) -> float:
    """Deviance per count of the best pass of the finest voxels."""
    size, misfits = min(grid.spacing) * COARSE.levels[-1][0], [np.inf]

    def watch(iteration: Iteration) -> None:
        if iteration.grid is not None and np.isclose(min(iteration.grid.spacing), size) and iteration.residual:
            misfits.append(iteration.residual)

    COARSE.reconstruct_counts(measured, grid, watch)
    return float(min(misfits))
