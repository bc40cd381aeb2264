"""What the memory of a fit is made of, and how to stay within a bound.

The counts of all views with their shares, and the line integrals that the start decomposes them into, are the arrays
that grow with the scan. Where all would not fit, they live in files beside the run, and a few views are in memory at a
time. All else is per view, per voxel or per Gaussian. No number depends on where arrays live.
"""

from dataclasses import dataclass
from math import prod

from phantomgen.dataset.reader import Dataset
from phantomgen.geometry.voxel_grid import Grid
from recon.data.measurements import matching_bin
from recon.gaussians.recipe import Recipe
from spectra.errors import InputError

GIB = 2**30
PROGRAM = 0.55  # GiB: torch, numba, h5py and compiled kernels; a scan of 9 views of 32 x 32 pixels takes as much
GAUSSIANS_PER_VOXEL = 0.07  # at a spacing of 1, where nobody has counted yet; the preset kedge-small has 0.066
_BYTES_PER_GAUSSIAN = 1600  # parameters, moments, gradients in float64, curvature, two footprint tables
_CURVATURE_VIEWS = 5  # as many are rasterized at once
_FDK_VIEWS = 16
_ONE_STEP_VOLUMES = 14  # of each basis


@dataclass(frozen=True)
class MemoryPlan:
    """Expected peak of a fit [GiB], by what it consists of.

    Parameters
    ----------
    parts : sizes by name; ``counts`` and ``line integrals`` are what can live on disk
    on_disk : whether those do
    """

    parts: dict[str, float]
    on_disk: bool

    @property
    def peak(self) -> float:
        """Sum of what is in memory."""
        return sum(size for name, size in self.parts.items() if not (self.on_disk and name in MOVABLE))

    def __str__(self) -> str:
        parts = ", ".join(f"{name} {size:.2f}" for name, size in self.parts.items())
        where = "; counts and line integrals on disk" if self.on_disk else ""
        return f"{self.peak:.2f} GiB ({parts}{where})"


MOVABLE = ("counts", "line integrals")


def plan_memory(
    dataset: Dataset,
    recipe: Recipe,
    bases: int | None,
    limit: float | None,
    gaussians: int | None = None,
    grid: Grid | None = None,
) -> MemoryPlan:
    """Expected peak, with large arrays on disk where it would exceed `limit` [GiB] otherwise.

    Parameters
    ----------
    dataset : an open dataset
    recipe : hyper-parameters
    bases : how many basis functions are fitted, default all
    limit : largest memory to take [GiB]; None for no limit
    gaussians : how many there are, where somebody knows
    grid : that is fitted, see `recon.gaussians.fitted_grid`; default that of the dataset, which a margin makes larger

    Raises
    ------
    InputError
        When the limit cannot be kept.
    """
    grid = grid or dataset.grid
    plan = MemoryPlan(_parts(dataset, recipe, bases, gaussians, grid), on_disk=False)
    if limit is None or plan.peak <= limit:
        return plan
    plan = MemoryPlan(plan.parts, on_disk=True)
    if plan.peak > limit:
        of = f"a fit of {dataset.path} on {' x '.join(map(str, grid.shape))} voxels"
        margin = "" if grid == dataset.grid else ", a margin around the truncated object included,"
        raise InputError(f"{of}{margin} needs at least {plan}, more than --memory {limit:g} allows")
    return plan


def _parts(dataset: Dataset, recipe: Recipe, bases: int | None, gaussians: int | None, grid: Grid) -> dict[str, float]:
    _, channels, rows, columns = dataset.counts.shape
    views, pixels, voxels = len(dataset.splits["train"]), rows * columns, prod(grid.shape)
    m = bases or len(dataset.spectra.basis)
    factor = matching_bin(dataset.geometry, min(dataset.grid.spacing)) ** 2
    if gaussians is None:
        gaussians = round(GAUSSIANS_PER_VOXEL * voxels / recipe.distance(views) ** 2)
    per_step = recipe.views_per_step * 4 * (3 * m + 1) + 4 * 12 * channels + 8 * (channels * (m + 2) + 2 * m)
    pairs = m * (m + 1) // 2
    curvature = _CURVATURE_VIEWS * 4 * (m + 1 + 4 * pairs) + 8 * channels * (m + 2) + 8 * m * m * 2
    filtering = _FDK_VIEWS * m * (3 * 4 + 2 * 8) // factor
    sizes = {
        "counts": 2 * 4 * views * channels * pixels,  # before and after their correction, or they and their shares
        "line integrals": 4 * views * m * pixels // factor,
        "flats and gains": 8 * 5 * channels * pixels,
        "images": max(per_step, curvature, filtering) * pixels,
        "volumes": 4 * voxels * max(4 * m + 14, _ONE_STEP_VOLUMES * m if recipe.prior else 0),
        "Gaussians": _BYTES_PER_GAUSSIAN * gaussians,
    }
    return {"program": PROGRAM, **{name: size / GIB for name, size in sizes.items()}}
