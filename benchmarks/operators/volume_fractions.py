"""Volume fractions of every shape against exact chords along 256 x 256 lines per voxel.

    python -m benchmarks.operators.volume_fractions [LINES]

The reference traces lines along z through each column of voxels that a surface passes, at the midpoints of a regular
grid, clips each chord to each voxel and takes the mean; the chords are those that `chords.py` holds to extended
precision. Its own error is that of midpoints across an edge, below 1/LINES of a voxel for a surface along z and far
below that for others. Errors are in parts of a voxel.
"""

import sys
import time

import numpy as np

from benchmarks.operators.chords import SHAPES
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.trace import trace
from phantomgen.ops.voxelize_shapes import fractions
from phantomgen.shapes import Placed, rotation_matrix, solids_of

GRID = Grid.cube(32, 96.0)
COLUMNS = 24


def lines_per_voxel(solids, column: tuple[int, int], lines: int) -> np.ndarray:
    """Fractions of all voxels of one column from `lines` squared lines along z."""
    (dz, dy, dx), (z, y, x) = GRID.spacing, GRID.origin
    places = (np.arange(lines) + 0.5) / lines - 0.5
    row, col = column
    ys, xs = (a.ravel() for a in np.meshgrid(y + (row + places) * dy, x + (col + places) * dx, indexing="ij"))
    found = []
    for k in range(GRID.shape[0]):
        origins = np.column_stack([xs, ys, np.full(len(xs), z + (k - 0.5) * dz)])
        lengths = trace(origins, np.broadcast_to([0.0, 0.0, dz], origins.shape), solids, 1)[:, 0]
        found.append(lengths.mean() / dz)
    return np.array(found)


def main(lines: int) -> None:
    print(f"{'shape':<20}{'voxels':>8}{'partial':>9}{'worst':>10}{'rms':>10}{'volume':>10}{'ms/voxelize':>13}")
    for name, shape in SHAPES.items():
        rng = np.random.default_rng(0)
        placed = Placed(shape, rotation_matrix(tuple(rng.uniform(-3, 3, 3))), rng.uniform(-1.5, 1.5, 3))
        solids = solids_of([(placed, 0)])
        fractions(GRID, solids, 1)
        began = time.perf_counter()
        found = fractions(GRID, solids, 1)[0]
        took = time.perf_counter() - began
        partial = (found > 1e-6) & (found < 1 - 1e-6)
        columns = np.argwhere(partial.any(axis=0))
        columns = columns[rng.permutation(len(columns))[:COLUMNS]]
        error = np.concatenate(
            [found[:, row, col] - lines_per_voxel(solids, (row, col), lines) for row, col in columns]
        )
        cut = np.concatenate([partial[:, row, col] for row, col in columns])
        filled = found.sum(dtype=np.float64) * GRID.voxel_volume
        volume = filled / placed.volume - 1 if placed.volume else np.nan
        print(
            f"{name:<20}{error.size:>8}{cut.sum():>9}{np.abs(error).max():>10.1e}"
            f"{np.sqrt((error[cut] ** 2).mean()):>10.1e}{volume:>10.1e}{took * 1e3:>13.0f}",
            flush=True,
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 256)
