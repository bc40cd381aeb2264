"""Width of the margin around truncated views, from how well voxels in it explain the counts.

`recon.data.coverage` assumes a round and homogeneous object. An object that is not, for instance a second one beside
the field of view, extends further, and what attenuates rays there has no voxel. Too wide a margin is no better: the
counts hardly determine it, and bases exchange low frequencies with the field of view. So coarse voxels are fitted in
wider and wider margins. Where the first margin leaves several times the least misfit, the narrowest margin with nearly
the least misfit is taken.
"""

from dataclasses import replace

import numpy as np

from phantomgen.geometry.voxel_grid import Grid
from recon.data.coverage import LARGEST, Coverage, border_distances, grown_to
from recon.data.measurements import Measurements
from recon.voxel.iterative.one_step import OneStep
from recon.voxel.method import Iteration

# no unit; width of each margin over that of the one before; chosen by hand, not measured
GROWTH = 1.15
# no unit, over the least misfit; the first margin stays below this, as wider ones cost Compton more than they gain;
# chosen on five scenes, where the first margin has at most 2.3 or 10 times the least misfit
# (docs/development/decisions/0012-truncation-margin.md)
LARGEST_FIRST_MISFIT = 3.0
# no unit, over the least misfit; coarse voxels cannot tell smaller differences from their own errors; chosen by hand
NEARLY_LEAST_MISFIT = 1.4
# voxels of 4 and 2 times the size of the grid, as many passes as a fit takes on them
COARSE_FIT = OneStep(levels=((4, 8), (2, 8)))


def with_margin_found(measured: Measurements, covered: Coverage) -> Coverage:
    """Widen the grid of a coverage until voxels in it explain the counts of truncated views.

    Parameters
    ----------
    measured : the scan, with counts corrected for partial volume
    covered : what `recon.data.coverage.coverage` found

    Returns
    -------
    coverage with the wider grid; `covered` itself where no view is truncated laterally
    """
    grids = margins(measured, covered)
    if len(grids) == 1:
        return covered
    misfits = [_misfit(measured, grid) for grid in grids]
    if misfits[0] <= LARGEST_FIRST_MISFIT * min(misfits):
        return covered
    close = next(i for i, misfit in enumerate(misfits) if misfit <= NEARLY_LEAST_MISFIT * min(misfits))
    return replace(covered, grid=grids[close])


def margins(measured: Measurements, covered: Coverage) -> list[Grid]:
    """List the grid of a coverage and wider ones, up to the largest object that `recon.data.coverage` assumes.

    Parameters
    ----------
    measured : the scan
    covered : what `recon.data.coverage.coverage` found

    Returns
    -------
    grids from narrow to wide
    """
    if not covered.lateral:
        return [covered.grid]
    grid, grids = covered.grid, [covered.grid]
    faces = [abs(grid.axis(name)[end]) + grid.spacing[2 - "xyz".index(name)] / 2 for name in "xy" for end in (0, -1)]
    low, high = (grid.axis("z")[end] + sign * grid.spacing[0] / 2 for end, sign in ((0, -1), (-1, 1)))
    radius, largest = max(faces), LARGEST * float(np.median(border_distances(measured.geometry).max(axis=1)))
    while (radius := GROWTH * radius) <= largest:
        wider = grown_to(grid, radius, (low, high))
        if wider != grids[-1]:
            grids.append(wider)
    return grids


def _misfit(measured: Measurements, grid: Grid) -> float:
    """Deviance per count of the best pass over the finest voxels of `COARSE_FIT`."""
    size, misfits = min(grid.spacing) * COARSE_FIT.levels[-1][0], [np.inf]

    def watch(iteration: Iteration) -> None:
        if iteration.grid is not None and np.isclose(min(iteration.grid.spacing), size) and iteration.residual:
            misfits.append(iteration.residual)

    COARSE_FIT.reconstruct_counts(measured, grid, watch)
    return float(min(misfits))
