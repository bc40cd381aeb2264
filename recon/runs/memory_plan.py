"""Memory that a fit will take, by its parts, and how to keep a limit.

The counts of all views with their shares, and the line integrals that the start decomposes them into, are the arrays
that grow with the scan. Where they would exceed the limit, they are kept in files in the run folder, and a few views
are in memory at a time. All else is per view, per voxel or per Gaussian. No result depends on where arrays are kept.
"""

from dataclasses import dataclass
from math import prod

from phantomgen.dataset.reader import Dataset
from phantomgen.geometry.voxel_grid import Grid
from recon.data.measurements import matching_bin
from recon.gaussians import fisher
from recon.gaussians.recipe import Recipe
from recon.gaussians.settings import SurfaceSettings
from recon.voxel.filtered import fdk
from spectra.errors import InputError

GIB = 2**30  # bytes
PROGRAM = (
    0.55  # GiB; torch, numba, h5py and compiled kernels; measured as the peak of a scan of 9 views of 32 x 32 pixels
)
GAUSSIANS_PER_VOXEL = 0.07  # at a spacing of 1 voxel, before they are placed; kedge-small has 0.066
GAUSSIANS_PER_SIDE = 1.0  # over the power 2/3 of the voxels, with planes and a detail of 1; kedge-small has 0.94
_BYTES_PER_GAUSSIAN = 1600  # bytes; parameters, moments, gradients in float64, curvature, two footprint tables
_ONE_STEP_VOLUMES = 14  # volumes of each basis that recon.voxel.iterative.one_step holds at its peak


@dataclass(frozen=True)
class MemoryPlan:
    """Expected peak memory of a fit, by its parts.

    Parameters
    ----------
    parts : sizes by name [GiB]; ``counts`` and ``line integrals`` can be kept on disk
    on_disk : whether those are
    """

    parts: dict[str, float]
    on_disk: bool

    @property
    def peak(self) -> float:
        """Sum of the parts that are in memory [GiB]."""
        return sum(size for name, size in self.parts.items() if not (self.on_disk and name in MOVABLE))

    def __str__(self) -> str:
        parts = ", ".join(f"{name} {size:.2f}" for name, size in self.parts.items())
        where = "; counts and line integrals on disk" if self.on_disk else ""
        return f"{self.peak:.2f} GiB ({parts}{where})"


MOVABLE = ("counts", "line integrals")  # parts that can be kept on disk


def plan_memory(
    dataset: Dataset,
    recipe: Recipe,
    bases: int | None,
    limit: float | None,
    gaussians: int | None = None,
    grid: Grid | None = None,
) -> MemoryPlan:
    """Estimate the peak memory, with large arrays on disk where it would exceed a limit otherwise.

    Parameters
    ----------
    dataset : open dataset
    recipe : hyper-parameters
    bases : number of basis functions to fit; None for all
    limit : largest memory to take [GiB]; None for no limit
    gaussians : number of Gaussians; None for an estimate
    grid : that is fitted, with the margin of a truncated scan, see `recon.gaussians.fitted_grid`; None for that of the
        dataset

    Returns
    -------
    the estimate, and whether arrays are on disk

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
        finer = SurfaceSettings().finest / recipe.surfaces.finest
        on_surfaces, inside = GAUSSIANS_PER_SIDE * voxels ** (2 / 3) * finer**2, GAUSSIANS_PER_VOXEL * voxels
        expected = on_surfaces if recipe.kernel == "interface" else inside / recipe.distance(views) ** 2
        gaussians = recipe.surfaces.count or round(expected)
    per_step = recipe.views_per_step * 4 * (3 * m + 1) + 4 * 12 * channels + 8 * (channels * (m + 2) + 2 * m)
    pairs = m * (m + 1) // 2
    curvature = fisher.VIEWS_AT_ONCE * 4 * (m + 1 + 4 * pairs) + 8 * channels * (m + 2) + 8 * m * m * 2
    filtering = fdk.VIEWS_AT_ONCE * m * (3 * 4 + 2 * 8) // factor
    sizes = {
        "counts": 2 * 4 * views * channels * pixels,  # before and after their correction, or they and their shares
        "line integrals": 4 * views * m * pixels // factor,
        "flats and gains": 8 * 5 * channels * pixels,
        "images": max(per_step, curvature, filtering) * pixels,
        "volumes": 4 * voxels * max(4 * m + 14, _ONE_STEP_VOLUMES * m if recipe.prior else 0),
        "Gaussians": _BYTES_PER_GAUSSIAN * gaussians,
    }
    return {"program": PROGRAM, **{name: size / GIB for name, size in sizes.items()}}
