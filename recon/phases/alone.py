"""Fits of each phase alone, averaged with the phases that were fitted together.

Shared shapes follow a motion only as far as the displacements of a lattice do, and a fit of one phase alone has the
noise of few views. Their errors are different, so that a weighted mean of both is better than either. Rays that take
no part in either fit are set apart in every phase, and choose the weight that makes them most likely. The Gaussians of
all views, from which the phases start, have seen a part of these rays, which favours shared shapes a little.
"""

from collections.abc import Callable
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.optimize import minimize_scalar
from torch import Tensor

from phantomgen.dataset.reader import Dataset
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.data.measurements import Measurements
from recon.gaussians.divided.model_file import load_model
from recon.gaussians.likelihood import deviance_of_images
from recon.gaussians.model import GaussianModel
from recon.gaussians.recipe import Recipe
from recon.gaussians.reconstruct import reconstruct
from recon.gaussians.unseen_rays import UnseenRays, with_unseen_rays
from recon.phases.model import Alone, PhaseGaussians
from recon.voxel.initial_volumes import check_directions
from spectra.errors import GeometryError

# Weights that are sought within so much, and of less than that are none [no unit].
_WEIGHT = 0.01
# File of a fit, by the division of the views and the phase.
_KEPT = "alone-{}-{}.safetensors"


def with_unseen_rays_of_phases(
    measured: Measurements, phase_of_view: Int[np.ndarray, " view"], voxel: float, recipe: Recipe
) -> Measurements:
    """Set rays of each phase apart, the same as a fit of this phase alone does.

    Parameters
    ----------
    measured : training views, unbinned
    phase_of_view : phase of each view, from 0 without gaps
    voxel : edge of a voxel of the reconstruction grid [mm]
    recipe : seed, and how many rays

    Returns
    -------
    the same scan with blocks of pixels marked
    """
    blocks = {}
    for phase in range(int(phase_of_view.max()) + 1):
        views = np.flatnonzero(phase_of_view == phase)
        apart = with_unseen_rays(measured[views], voxel, recipe.seed, recipe.unseen_rays).unseen_blocks
        assert apart is not None
        blocks.update(zip(views.tolist(), apart, strict=True))
    return replace(measured, unseen_blocks=np.stack([blocks[view] for view in range(len(measured))]))


def with_phases_alone(
    phases: PhaseGaussians,
    dataset: Dataset,
    measured: Measurements,
    phase_of_view: Int[np.ndarray, " view"],
    grid: Grid,
    recipe: Recipe,
    on_phase: Callable[[int], object] = lambda phase: None,
    folder: Path | None = None,
) -> PhaseGaussians:
    """Fit each phase alone as well, and weigh both by rays that took no part.

    Parameters
    ----------
    phases : fitted together
    dataset : open dataset
    measured : its training views, with rays of each phase set apart
    phase_of_view : phase of each view, from 0 without gaps
    grid : voxels of the scan
    recipe : of the fit of a phase
    on_phase : called with the number of a phase before it is fitted alone
    folder : keeps the fits until `remove_kept`, so that an interrupted run goes on after the last one; None for no such
        folder

    Returns
    -------
    the phases; as they are where the recipe has no voxel prior, without which a fit sets no rays apart, and where the
    views of a phase have one direction
    """
    alone: dict[int, Alone] = {}
    for phase in range(len(phases)) if recipe.prior else ():
        views = np.flatnonzero(phase_of_view == phase)
        own = measured[views]
        if not _determine_depth(own.geometry):
            continue
        kept = None if folder is None else folder / _KEPT.format(_digest(phase_of_view), phase)
        if kept is not None and kept.is_file():
            gaussians = load_model(kept)
        else:
            on_phase(phase)
            gaussians = reconstruct(dataset.with_training_views(views), recipe).gaussians
            if kept is not None:
                whole = kept.with_suffix(".new")
                gaussians.save(whole)
                whole.replace(kept)
        rays = UnseenRays.of(own, min(grid.spacing), recipe.dispersion, recipe.unseen_rays)
        weight = best_weight(phases.at(phase), gaussians, rays)
        if weight >= _WEIGHT:
            alone[phase] = Alone(gaussians, weight)
    return replace(phases, alone=alone)


def remove_kept(folder: Path) -> None:
    """Remove the fits of phases that are kept in a folder.

    Parameters
    ----------
    folder : of a run
    """
    for path in folder.glob(_KEPT.format("*", "*")):
        path.unlink()


def _digest(phase_of_view: Int[np.ndarray, " view"]) -> str:
    """Name of a division of the views."""
    return sha256(np.ascontiguousarray(phase_of_view, np.int64).tobytes()).hexdigest()[:12]


def best_weight(together: GaussianModel, alone: GaussianModel, rays: UnseenRays) -> float:
    """Find the weight of one of two models in their mean, for which rays are most likely.

    Parameters
    ----------
    together : model with the weight 1 - w
    alone : model with the weight w
    rays : rays that neither was fitted to

    Returns
    -------
    w, from 0 to 1
    """
    views = [rays.data[[view]] for view in range(len(rays.data))]

    def images(model: GaussianModel) -> list[Float[Tensor, "one basis row column"]]:
        with torch.no_grad():
            return [model.line_integrals(view.geometry) for view in views]

    first, second = images(together), images(alone)

    def total(weight: float) -> float:
        means = (torch.lerp(a, b, weight) for a, b in zip(first, second, strict=True))
        return sum(deviance_of_images(mean, view, rays.dispersion) for mean, view in zip(means, views, strict=True))

    found: Any = minimize_scalar(total, bounds=(0.0, 1.0), method="bounded", options={"xatol": _WEIGHT / 2})
    return float(min((found.x, 0.0, 1.0), key=total))


def _determine_depth(geometry: Geometry) -> bool:
    """Whether views can be reconstructed alone."""
    try:
        check_directions(geometry)
    except GeometryError:
        return False
    return True
