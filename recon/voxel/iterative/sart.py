"""Simultaneous algebraic reconstruction, with subsets of the views in turn.

A step is that of SIRT on a subset s of the views, with the row and column sums of its part of the matrix::

    x <- x + relaxation C_s A_s^T R_s w_s (b_s - A_s x)

One view per subset is SART (Andersen & Kak 1984, doi:10.1016/0161-7346(84)90008-7), several are OS-SART (Wang & Jiang
2004, doi:10.1137/S1064827502400679).
"""

from dataclasses import dataclass

import numpy as np

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.voxel.iterative.sirt import weighted_norm
from recon.voxel.method import Images, Iteration, OnIteration, Volumes, Weights, unwatched
from recon.voxel.projector_pair import Pair, inverse_or_zero

MOST = 90  # subsets, where their number is not said: more views share one


@dataclass(frozen=True)
class Sart:
    """OS-SART as a method; parameters as of `sart`."""

    iterations: int = 4
    subsets: int | None = None
    relaxation: float = 1.0
    decay: float = 0.7
    non_negative: bool = True

    @property
    def name(self) -> str:
        """What ``--method`` calls it."""
        return "sart"

    def reconstruct(
        self,
        line_integrals: Images,
        weights: Weights | None,
        geometry: Geometry,
        grid: Grid,
        on_iteration: OnIteration = unwatched,
    ) -> Volumes:
        """See `recon.voxel.method.LinearMethod`."""
        steps = self.iterations, self.subsets, self.relaxation, self.decay, self.non_negative
        return sart(line_integrals, geometry, grid, *steps, weights=weights, on_iteration=on_iteration)


def sart(
    line_integrals: Images,
    geometry: Geometry,
    grid: Grid,
    iterations: int = 4,
    subsets: int | None = None,
    relaxation: float = 1.0,
    decay: float = 0.7,
    non_negative: bool = True,
    weights: Weights | None = None,
    on_iteration: OnIteration = unwatched,
) -> Volumes:
    """Volumes [1/mm] of line integrals [no unit], from zero.

    Parameters
    ----------
    line_integrals : one image per basis and view
    geometry : any poses
    grid : the volume to reconstruct
    iterations : passes over all views
    subsets : parts into which the views are divided: as many as there are views is SART, 1 is SIRT; by default SART of
        up to `MOST` views
    relaxation : size of a step in the first pass
    decay : step of a pass over that of the one before
    non_negative : project on what is not negative after each step
    weights : how much each ray counts, at most 1; all alike if None
    on_iteration : called after every pass; the residual is ||R^1/2 (b - A x)|| over that of x = 0, each subset before
        its step

    Raises
    ------
    GeometryError
        When no ray meets the grid.
    """
    pair = Pair(geometry, grid)
    rows = pair.row_scales(weights)
    seen = (rows > 0).astype(np.float32) if weights is None else (weights * (rows > 0)).astype(np.float32)
    volumes = np.zeros((len(line_integrals), *grid.shape), np.float32)
    whole = weighted_norm(line_integrals, rows)
    parts = ordered_subsets(len(geometry), subsets or MOST)
    for done in range(1, iterations + 1):
        square = 0.0
        for views in parts:
            left = line_integrals[:, views] - pair.project(volumes, views)
            square += weighted_norm(left, rows[views]) ** 2
            both = np.concatenate([left * rows[views], seen[None, views]])  # one pass for the step and its scale
            *steps, sums = pair.transpose(both, views)
            volumes += relaxation * decay ** (done - 1) * inverse_or_zero(sums) * np.stack(steps)
            if non_negative:
                np.maximum(volumes, 0, out=volumes)
        on_iteration(Iteration(done, iterations, float(np.sqrt(square)) / whole, volumes))
    return volumes


def ordered_subsets(views: int, count: int) -> list[np.ndarray]:
    """Evenly spread subsets of the views, in an order that jumps around the orbit by golden sections."""
    count = min(count, views)
    wanted = max(round(0.382 * count), 1)
    stride = min((s for s in range(1, count + 1) if np.gcd(s, count) == 1), key=lambda s: abs(s - wanted))
    return [np.arange(i * stride % count, views, count) for i in range(count)]
