"""The start of a fit: voxel volumes from the counts, and Gaussians fitted to them."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.inpainting import inpainted
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.runtime.stopwatch import Stopwatch
from recon.data.coverage import Coverage
from recon.data.devices import device_named
from recon.data.material_decomposition import decompose_views
from recon.data.measurements import Measurements, matching_bin
from recon.gaussians.initial.fit_to_volume import evaluations_for, fit_to_volume, metric_of
from recon.gaussians.initial.initialize import initialize
from recon.gaussians.model import GaussianModel
from recon.gaussians.processes import Resources
from recon.gaussians.recipe import Recipe
from recon.voxel.initial_volumes import initial_volumes, starting_method
from recon.voxel.iterative.multigrid import occupied
from recon.voxel.iterative.one_step import OneStep
from recon.voxel.method import CountsMethod, Method, OnIteration


class Scan(NamedTuple):
    """What the fit knows of the scan before the start.

    Parameters
    ----------
    measured : training views, unbinned, with rays set apart
    node_error : largest error of the log counts from compressing the energy grid
    coverage : what the views cover of the object; its grid is fitted, and the part beyond the dataset's is cut off
    fisher : mean Fisher matrix of the rays' line integrals
    air : voxels of air around the grid where it was enlarged, else 0
    """

    measured: Measurements
    node_error: float
    coverage: Coverage
    fisher: Float[np.ndarray, "basis basis"]
    air: int


class OccupiedPart(NamedTuple):
    """The part of volumes that is not empty.

    Parameters
    ----------
    volumes : this part, (M, Z, Y, X) [1/mm]
    grid : its voxels
    """

    volumes: Float[np.ndarray, "basis z y x"]
    grid: Grid


Placement = Callable[[OccupiedPart, Scan, Recipe, Stopwatch, OnIteration, Resources], GaussianModel]


def start_method(measured: Measurements, grid: Grid, recipe: Recipe, device: str = "cpu") -> Method:
    """Choose the method of the first volumes: voxels from counts for a voxel prior, or decomposed rays without one.

    Parameters
    ----------
    measured : training views
    grid : voxels to reconstruct
    recipe : strength of the prior, and passes over the views
    device : where voxels are computed, ``cpu`` or ``cuda``

    Returns
    -------
    method with its settings
    """
    if not recipe.prior:
        return starting_method(measured.geometry, grid)
    coarse = OneStep().levels[:-1]
    levels = (*coarse, (1, recipe.voxel_passes))
    return OneStep(levels=levels, least_fall=recipe.voxel_fall, device=device, curve=recipe.curve)


def first_guess(
    scan: Scan,
    recipe: Recipe,
    stage: Stopwatch,
    on_iteration: OnIteration,
    resources: Resources,
    place: Placement,
) -> tuple[Float[np.ndarray, "basis z y x"], GaussianModel]:
    """Reconstruct the first volumes, and fit Gaussians to them.

    Parameters
    ----------
    scan : training views, and what is known of them
    recipe : settings
    stage : stopwatch of the stages
    on_iteration : called after every pass over voxels, and after every evaluation of the fit to the volumes
    resources : device of the Gaussians, and where line integrals are kept
    place : makes Gaussians of the volumes, such as `plain_gaussians`

    Returns
    -------
    volumes on the grid that is fitted, (M, Z, Y, X) [1/mm]; Gaussians on the processor
    """
    measured, grid = scan.measured, scan.coverage.grid
    method = start_method(measured, grid, recipe, resources.device)
    if isinstance(method, CountsMethod):
        with stage(method.name):
            volumes = method.reconstruct_counts(measured, grid, on_iteration)
    else:
        coarse = measured.completed().binned(matching_bin(measured.geometry, min(grid.spacing)))
        with stage("decompose"):
            line_integrals = decompose_views(coarse, recipe.dispersion, resources.store)[0]
            for image in line_integrals if coarse.blind_pixels.any() else ():
                image[:] = inpainted(image, coarse.blind_pixels)
        with stage(method.name):
            volumes = initial_volumes(line_integrals, coarse.blind_pixels, coarse.geometry, grid, method)
    part = part_with_gaussians(volumes, scan, recipe)
    return volumes, place(part, scan, recipe, stage, on_iteration, resources)


def part_with_gaussians(volumes: Float[np.ndarray, "basis z y x"], scan: Scan, recipe: Recipe) -> OccupiedPart:
    """Cut off the part of volumes where Gaussians are placed, and to which the voxel prior keeps them close.

    Parameters
    ----------
    volumes : on the grid that is fitted, (M, Z, Y, X) [1/mm]
    scan : the grid that is fitted, and the air around it
    recipe : whether planes divide the Gaussians, which then have air around them

    Returns
    -------
    the part that is not empty, and the air around it
    """
    part = occupied_part(volumes, scan.coverage.grid, scan.air)
    if recipe.kernel != "interface":
        return part
    return in_air(part, recipe.surfaces.air, alike=scan.measured.geometry.panel.rows == 1)


def plain_gaussians(
    occupied: OccupiedPart,
    scan: Scan,
    recipe: Recipe,
    stage: Stopwatch,
    on_iteration: OnIteration,
    resources: Resources,
) -> GaussianModel:
    """Place Gaussians, and fit them to the volumes where the recipe has a voxel prior; a `Placement`.

    Parameters
    ----------
    occupied : volumes
    scan : what is known of the scan
    recipe : settings
    stage : stopwatch of the stages
    on_iteration : called after every evaluation of the fit to the volumes
    resources : device of the Gaussians

    Returns
    -------
    Gaussians on the processor
    """
    with stage("initialize"):
        spacing = recipe.distance(len(scan.measured)) * min(occupied.grid.spacing)
        gaussians = initialize(
            *occupied, scan.fisher, spacing, scan.measured.basis_names, recipe.seed, recipe.placement
        )
    if not recipe.prior:
        return gaussians
    metric = metric_of(occupied.volumes, scan.fisher, recipe.volume_fit)
    with stage("approximate"):
        evaluations = evaluations_for(len(gaussians), recipe.approximation, recipe.volume_fit)
        gaussians = gaussians.to(device_named(resources.device))
        gaussians = fit_to_volume(gaussians, *occupied, metric, evaluations, on_iteration, recipe.volume_fit)
    return gaussians.to("cpu")


def occupied_part(volumes: Float[np.ndarray, "basis z y x"], grid: Grid, air: int) -> OccupiedPart:
    """Cut off the empty border of volumes, after adding voxels of air around them.

    A grid that was enlarged ends where its object does; with air around it, Gaussians do not extend beyond the object
    unless the counts require it.

    Parameters
    ----------
    volumes : volumes of all bases, (M, Z, Y, X) [1/mm]
    grid : their voxels
    air : voxels of air to add on every side

    Returns
    -------
    the smallest box with all that is not empty
    """
    volumes, grid = in_air(OccupiedPart(volumes, grid), air)
    box = occupied(volumes)
    return OccupiedPart(np.ascontiguousarray(volumes[:, *box]), grid.part(box))


def in_air(part: OccupiedPart, voxels: int, alike: bool = False) -> OccupiedPart:
    """Add empty voxels around volumes.

    Parameters
    ----------
    part : volumes
    voxels : number to add on every side
    alike : whether a single slice goes on above and below as it is, which a panel of one row cannot tell

    Returns
    -------
    larger volumes
    """
    grid = part.grid
    if voxels == 0:
        return part
    origin = tuple(o - voxels * s for o, s in zip(grid.origin, grid.spacing, strict=True))
    larger = Grid(tuple(n + 2 * voxels for n in grid.shape), grid.spacing, origin)  # type: ignore[arg-type]
    both = (voxels, voxels)
    if alike and grid.shape[0] == 1:
        stacked = np.pad(part.volumes, ((0, 0), both, (0, 0), (0, 0)), mode="edge")
        return OccupiedPart(np.pad(stacked, ((0, 0), (0, 0), both, both)), larger)
    return OccupiedPart(np.pad(part.volumes, ((0, 0), both, both, both)), larger)
