"""Log projections of all channels together, with their statistical weights, in pixels as large as an alignment needs."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Float32

from phantomgen.dataset.reader import Dataset
from phantomgen.geometry.panel_changes import smaller_panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from spectra.errors import InputError

_LEAST_COUNTS = 0.5  # counts below are set to this before the logarithm


@dataclass(frozen=True, eq=False)
class Projections:
    """Line integrals of some views.

    Parameters
    ----------
    values : line integrals [no unit], 0 where the weight is 0
    weights : of each pixel in a least-squares sum, 0 for pixels that do not measure; the inverse variance of the values
        up to a common factor
    geometry : poses that the file states
    grid : voxels that hold the object
    """

    values: Float32[np.ndarray, "view row column"]
    weights: Float32[np.ndarray, "view row column"]
    geometry: Geometry
    grid: Grid

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, views: slice) -> "Projections":
        """Take some of the views."""
        return replace(self, values=self.values[views], weights=self.weights[views], geometry=self.geometry[views])


def read_projections(dataset: Dataset, views: int, columns: int, voxels: int) -> Projections:
    """Read log projections of training views.

    Parameters
    ----------
    dataset : open dataset
    views : largest number of views, evenly spread
    columns : largest number of columns; pixels are summed until there are no more
    voxels : largest number of voxels along an edge of the grid

    Returns
    -------
    the projections

    Raises
    ------
    InputError
        When no pixel measures.
    """
    train = dataset.splits["train"]
    chosen = train[:: -(-len(train) // views)]
    panel = dataset.geometry.panel
    factor = min(-(-panel.columns // columns), panel.rows, panel.columns)
    kept = tuple(slice(0, count // factor * factor) for count in (panel.rows, panel.columns))
    works, air = np.logical_not(dataset.mask), dataset.flat
    if dataset.spectra.dead_time is not None:
        air = dataset.spectra.dead_time.corrected(air)
    images, weights = [], []
    for view in chosen:
        signal = dataset.load([int(view)])[0] - dataset.dark
        if dataset.spectra.dead_time is not None:
            signal = dataset.spectra.dead_time.corrected(signal)
        beam = air * dataset.exposure[view][:, None, None]
        passed, sent = (_summed(np.where(works & (beam > 0), part, 0.0)[:, *kept], factor) for part in (signal, beam))
        measured = sent > 0
        logs = np.log(np.where(measured, sent, 1.0) / np.maximum(passed, _LEAST_COUNTS))
        images.append(np.where(measured, logs, 0.0))
        weights.append(np.where(measured, np.clip(passed, 0.0, sent), 0.0))
    stacked = np.array(weights, dtype=np.float32)
    if not stacked.any():
        raise InputError(f"{dataset.path}: no pixel measures, so that the panel cannot be found")
    geometry = smaller_panel(dataset.geometry[chosen], kept[1], factor, kept[0])
    return Projections(
        np.array(images, dtype=np.float32), stacked / stacked.max(), geometry, _coarser(dataset.grid, voxels)
    )


def _summed(images: Float[np.ndarray, "channel row column"], factor: int) -> Float[np.ndarray, "row column"]:
    """Sum over channels and over blocks of pixels."""
    rows, columns = (size // factor for size in images.shape[1:])
    return images.sum(axis=0).reshape(rows, factor, columns, factor).sum(axis=(1, 3))


def _coarser(grid: Grid, most: int) -> Grid:
    """Voxels of the same box, not more than `most` along an edge."""
    shape = np.minimum(grid.shape, most)
    size = np.array(grid.shape) * grid.spacing
    spacing = size / shape
    origin = np.array(grid.origin) - np.array(grid.spacing) / 2 + spacing / 2
    z, y, x = (int(count) for count in shape)
    (dz, dy, dx), (oz, oy, ox) = spacing.tolist(), origin.tolist()
    return Grid((z, y, x), (dz, dy, dx), (oz, oy, ox))
