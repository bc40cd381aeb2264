"""Photons that free electrons scatter once.

Model: first-order Compton scatter. Photons on their way from the source are weakened up to a point of the object, are
scattered there by the angle theta with the cross section of free electrons at rest (Klein & Nishina 1929,
doi:10.1007/BF01366453), have less energy from then on, and are weakened on the way to the panel:

    k = 1 / (1 + (E / 511 keV) (1 - cos theta)),   E' = k E
    d sigma / d Omega = r_e^2 / 2  k^2 (k + 1/k - sin^2 theta)

Left out: photons that scatter more than once, coherent scatter, the binding of electrons, and what lies beyond the
panel's beam or the volume. There is no grid against scatter. Flats hold no scatter.

One random point stands for all electrons in each cell of a coarse grid, which errs less than their centre does, as
photons are weakened by very different amounts within a cell; `phantomgen.ops.compton` sums over them. The result is
smooth: it is computed at few places of the panel, and splines give the pixels.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from phantomgen.geometry.voxel_grid import Grid


@dataclass(frozen=True)
class ComptonScatter:
    """Single scatter of the scene's own objects and photons; nothing is to be chosen."""


def scatterers(
    density: Float[np.ndarray, "z y x"], grid: Grid, cells: int, rng: np.random.RandomState
) -> tuple[Float[np.ndarray, "point 3"], Float[np.ndarray, " point"]]:
    """A random place (x, y, z) [mm] in each of `cells`^3 blocks that holds anything, and how much the block holds.

    Parameters
    ----------
    density : per volume [1/mm^3]; where there is more, the place is more likely
    grid : of the voxels, whose number along each axis is a multiple of `cells`
    cells : along each axis
    rng : random numbers
    """
    block = [n for size in density.shape for n in (cells, size // cells)]
    held = (density * grid.voxel_volume).reshape(block).transpose(0, 2, 4, 1, 3, 5).reshape(cells**3, -1)
    upto = np.cumsum(held, axis=1)
    some = np.flatnonzero(upto[:, -1] > 0)
    wish = rng.random_sample(len(some)) * upto[some, -1]
    voxel = (upto[some] <= wish[:, None]).sum(axis=1)
    index = np.array(np.unravel_index(some, (cells,) * 3)) * np.array([block[1::2]]).T
    index += np.array(np.unravel_index(voxel, block[1::2]))
    zyx = (index.T + rng.random_sample((len(some), 3)) - 0.5) * grid.spacing + grid.origin
    return np.ascontiguousarray(zyx[:, ::-1]), upto[some, -1]


def spline_weights(count: int, places: int) -> Float[np.ndarray, "pixel place"]:
    """Values at the centres of `count` pixels from values at places evenly spread from edge to edge of their line."""
    from scipy.interpolate import make_interp_spline  # noqa: PLC0415 - slow to import, and seldom needed

    return make_interp_spline(line_places(count, places), np.eye(places), k=min(3, places - 1))(np.arange(count))


def line_places(count: int, places: int) -> Float[np.ndarray, " place"]:
    """Places from the first to the last edge of a line of `count` pixels [pixel]."""
    return np.linspace(-0.5, count - 0.5, places)


def on_panel(
    frame: Float[np.ndarray, "4 3"], place: Float[np.ndarray, "point 3"], rows: int, columns: int
) -> tuple[Bool[np.ndarray, " point"], Float[np.ndarray, "point 2"]]:
    """Which points lie in the beam between source and panel, and the row and column that they project to [pixel]."""
    depth, column, row = np.linalg.solve(frame[1:].T, (place - frame[0]).T)
    column, row = column / depth, row / depth
    beam = (depth > 0) & (depth < 1) & (np.abs(column - (columns - 1) / 2) < columns / 2)
    return beam & (np.abs(row - (rows - 1) / 2) < rows / 2), np.stack([row, column], axis=1)
