"""What a set of primitives looks like in a view, and what is asked of it beside that: one class per kind.

All kinds have the parameters of `recon.published_methods.paper.model.FactorisedGaussians`, of which the fractions are
not used.
"""

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.ops.voxelize import voxelize
from recon.published_methods.paper.loss import patch_of_channels, random_patch, total_variation
from recon.published_methods.paper.model import FactorisedGaussians, Units
from recon.published_methods.paper.projections import line_integrals
from recon.published_methods.paper.recipe import PaperRecipe

Image = Float[Tensor, "view 1 row column"]


@runtime_checkable
class Primitives(Protocol):
    """One kind of primitive."""

    def unit(self, units: Units) -> float:
        """What counts as 1 in an image of this kind."""
        ...

    def images(
        self, centres: Float[Tensor, "gaussian 3"], model: FactorisedGaussians, units: Units, geometry: Geometry
    ) -> Image:
        """What the model shows in some views with its centres [mm] at `centres`; differentiable."""
        ...

    def penalty(
        self, model: FactorisedGaussians, grid: Grid, units: Units, recipe: PaperRecipe, rng: np.random.Generator
    ) -> Float[Tensor, ""] | float:
        """What is added to the loss whatever the view."""
        ...


class VolumePrimitives(Primitives, Protocol):
    """One kind of primitive that attenuates."""

    def volume(self, model: FactorisedGaussians, units: Units, grid: Grid) -> Float[np.ndarray, "z y x"]:
        """Attenuation on a grid [1/mm]."""
        ...


@dataclass(frozen=True)
class Attenuation:
    """Gaussians of attenuation with the rectified local-affine footprint of R2-Gaussian, and its total variation."""

    def unit(self, units: Units) -> float:
        """See `Primitives`."""
        return units.line_integral

    def images(
        self, centres: Float[Tensor, "gaussian 3"], model: FactorisedGaussians, units: Units, geometry: Geometry
    ) -> Image:
        """See `Primitives`."""
        coefficients = units.density * model.density()
        return line_integrals(
            centres, model.log_scales(units), model.quaternions, coefficients, geometry, "local-affine"
        )

    def penalty(
        self, model: FactorisedGaussians, grid: Grid, units: Units, recipe: PaperRecipe, rng: np.random.Generator
    ) -> Float[Tensor, ""]:
        """Total variation of a random piece of the volume."""
        parts = (model.centres, model.log_scales(units), model.quaternions, model.density())
        return (
            recipe.volume_tv
            * total_variation(patch_of_channels(*parts, torch.ones(1, 1), random_patch(grid, recipe.patch, rng))).sum()
        )

    def volume(self, model: FactorisedGaussians, units: Units, grid: Grid) -> Float[np.ndarray, "z y x"]:
        """See `VolumePrimitives`."""
        centres, log_scales, turns = (x.detach() for x in (model.centres, model.log_scales(units), model.quaternions))
        return voxelize(centres, log_scales, turns, units.density * model.density().detach(), grid)[0]


@dataclass(frozen=True)
class Radiance:
    """Gaussians that shine: each adds its radiance times exp(-q/2) on the panel, however long a ray is inside it.

    A local-affine footprint has the height b sqrt(2 pi) / |S^-1 R^T e| for a ray with unit vector e through the centre;
    divided by all but b it is the same from every side. So what one view says of a Gaussian is wrong in others, and
    there is no volume that has these projections.
    """

    def unit(self, units: Units) -> float:
        """See `Primitives`; `Units.density` holds a radiance."""
        return units.density

    def images(
        self, centres: Float[Tensor, "gaussian 3"], model: FactorisedGaussians, units: Units, geometry: Geometry
    ) -> Image:
        """See `Primitives`."""
        log_scales = model.log_scales(units)
        radiance = units.density * model.density()
        views = []
        for number, source in enumerate(torch.from_numpy(geometry.source).to(centres)):
            along = torch.nn.functional.normalize(centres.detach() - source, dim=1)
            height = math.sqrt(2 * math.pi) / _stretch(along, log_scales, model.quaternions)
            parts = (centres, log_scales, model.quaternions, radiance / height[:, None])
            views.append(line_integrals(*parts, geometry[number : number + 1], "local-affine"))
        return torch.cat(views)

    def penalty(
        self, model: FactorisedGaussians, grid: Grid, units: Units, recipe: PaperRecipe, rng: np.random.Generator
    ) -> float:
        """Nothing: X-Gaussian looks at images only."""
        return 0.0


def _stretch(
    along: Float[Tensor, "gaussian 3"],
    log_scales: Float[Tensor, "gaussian 3"],
    quaternions: Float[Tensor, "gaussian 4"],
) -> Float[Tensor, " gaussian"]:
    """|S^-1 R^T e| of unit vectors e [1/mm]; R^T e is e turned by the conjugate quaternion."""
    quaternions = torch.nn.functional.normalize(quaternions, dim=1)
    w, axis = quaternions[:, :1], -quaternions[:, 1:]
    twice = 2 * torch.linalg.cross(axis, along)
    turned = along + w * twice + torch.linalg.cross(axis, twice)
    return (torch.exp(-log_scales) * turned).norm(dim=1)
