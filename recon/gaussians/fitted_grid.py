"""The grid that a fit uses: the one asked for, with a margin where the object leaves the panel or the grid."""

from pathlib import Path
from typing import NamedTuple

from phantomgen.dataset.reader import Dataset
from phantomgen.geometry.voxel_grid import Grid
from recon.data.array_store import IN_MEMORY, ArrayStore, array_store
from recon.data.coverage import VIEWS, Coverage, coverage
from recon.data.measurements import Measurements, read_measurements
from recon.data.view_subsets import evenly_spread_views, view_groups
from recon.gaussians.recipe import Recipe
from recon.voxel.margin import with_margin_found


class TrainingViews(NamedTuple):
    """Training views as a fit uses them.

    Parameters
    ----------
    measured : counts without partial volume, with few energy nodes
    node_error : largest error of the log counts from compressing the energy grid [no unit]
    coverage : what they cover of the object; its grid is fitted
    """

    measured: Measurements
    node_error: float
    coverage: Coverage


def read_with_coverage(
    dataset: Dataset, recipe: Recipe, bases: int | None = None, store: ArrayStore = IN_MEMORY
) -> TrainingViews:
    """Read the training views as a fit uses them, and find what they cover of the object.

    Parameters
    ----------
    dataset : an open dataset
    recipe : settings of the fit
    bases : how many of the dataset's basis functions to use, default all
    store : where counts are kept

    Returns
    -------
    the views, and the grid that is to be fitted to them
    """
    whole = read_measurements(dataset, dataset.splits["train"], bases, store, separable=recipe.curve is None)
    covered = coverage(whole, dataset.grid)
    whole = whole.without_partial_volume(store)
    measured, node_error = whole.compressed(recipe.node_tolerance)
    return TrainingViews(measured, node_error, with_margin_found(measured, covered))


def fitted_grid(dataset: Dataset, recipe: Recipe, bases: int | None, folder: Path) -> Grid:
    """Find the grid that a fit uses before memory is planned.

    Only a scan that is truncated laterally is read as a whole; for others some views suffice.

    Parameters
    ----------
    dataset : an open dataset
    recipe : settings of the fit
    bases : how many of the dataset's basis functions to use, default all
    folder : an existing folder; counts are in files there until the grid is found

    Returns
    -------
    the dataset's grid, or a larger one
    """
    train = dataset.splits["train"]
    some = train[evenly_spread_views(view_groups(dataset.exposure[train]), VIEWS)]
    with array_store(folder, on_disk=True) as store:
        measured = read_measurements(dataset, some, bases, store, separable=recipe.curve is None)
        covered = coverage(measured, dataset.grid)
        return read_with_coverage(dataset, recipe, bases, store).coverage.grid if covered.lateral else covered.grid
