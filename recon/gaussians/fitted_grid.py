"""Which grid a fit takes: the one asked for, with a margin where the object leaves the panel or the grid."""

from pathlib import Path

from phantomgen.dataset.reader import Dataset
from phantomgen.geometry.voxel_grid import Grid
from recon.data.array_store import IN_MEMORY, ArrayStore, array_store
from recon.data.coverage import VIEWS, Coverage, coverage
from recon.data.measurements import Measurements, read_measurements
from recon.data.view_subsets import kinds_of, spread
from recon.gaussians.recipe import Recipe
from recon.voxel.margin import with_margin_found


def read_with_coverage(
    dataset: Dataset, recipe: Recipe, bases: int | None = None, store: ArrayStore = IN_MEMORY
) -> tuple[Measurements, float, Coverage]:
    """The training views as a fit takes them, and what they cover of the object.

    Parameters
    ----------
    dataset : an open dataset
    recipe : hyper-parameters
    bases : how many of the dataset's basis functions to use, default all
    store : where counts live

    Returns
    -------
    measurements without partial volume; the worst error of the log counts from compressing the energy grid; coverage,
    whose grid is fitted
    """
    whole = read_measurements(dataset, dataset.splits["train"], bases, store)
    covered = coverage(whole, dataset.grid)
    whole = whole.without_partial_volume(store)
    measured, node_error = whole.compressed(recipe.node_tolerance)
    return measured, node_error, with_margin_found(measured, covered)


def fitted_grid(dataset: Dataset, recipe: Recipe, bases: int | None, folder: Path) -> Grid:
    """The grid that a fit takes, found before memory is planned: counts are in files in `folder` meanwhile.

    Only a scan that is truncated laterally is read as a whole; for others some views tell.
    """
    train = dataset.splits["train"]
    some = train[spread(kinds_of(dataset.exposure[train]), VIEWS)]
    with array_store(folder, on_disk=True) as store:
        covered = coverage(read_measurements(dataset, some, bases, store), dataset.grid)
        return read_with_coverage(dataset, recipe, bases, store)[2].grid if covered.lateral else covered.grid
