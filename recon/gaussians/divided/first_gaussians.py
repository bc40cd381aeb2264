"""The first divided Gaussians of a fit: placed on surfaces, fitted to the voxel volumes, and sharpened."""

from dataclasses import replace

from phantomgen.runtime.stopwatch import Stopwatch
from recon.data.devices import device_named
from recon.gaussians.divided.fit_to_volume import fit_divided_to_volume, solve_coefficients
from recon.gaussians.divided.model import DividedGaussians
from recon.gaussians.divided.placement import place_on_surfaces
from recon.gaussians.initial.first_guess import OccupiedPart, Scan
from recon.gaussians.initial.fit_to_volume import metric_of
from recon.gaussians.processes import Resources
from recon.gaussians.recipe import Recipe
from recon.voxel.method import OnIteration


def divided_gaussians(
    occupied: OccupiedPart,
    scan: Scan,
    recipe: Recipe,
    stage: Stopwatch,
    on_iteration: OnIteration,
    resources: Resources,
) -> DividedGaussians:
    """Place divided Gaussians and fit them to the volumes; a `recon.gaussians.initial.first_guess.Placement`.

    Voxels blur an edge, so that the transition is wider while the Gaussians are fitted to them than for the counts.

    Parameters
    ----------
    occupied : volumes, and the air around them
    scan : what is known of the scan
    recipe : settings
    stage : stopwatch of the stages
    on_iteration : called after every evaluation of the fit to the volumes
    resources : device of the Gaussians

    Returns
    -------
    Gaussians on the processor, with the width of the transition for the fit to the counts
    """
    settings, metric = recipe.surfaces, metric_of(occupied.volumes, scan.fisher, recipe.volume_fit)
    with stage("initialize"):
        gaussians = place_on_surfaces(*occupied, metric, scan.measured.basis_names, recipe.seed, settings)
        gaussians = gaussians.to(device_named(resources.device))
        gaussians = solve_coefficients(gaussians, *occupied, metric, settings.solves)
    with stage("approximate"):
        steps = replace(recipe.volume_fit, cutoff=settings.cutoff)
        gaussians = fit_divided_to_volume(gaussians, *occupied, metric, recipe.approximation, on_iteration, steps)
    return replace(gaussians.to("cpu"), width=settings.width * min(occupied.grid.spacing))
