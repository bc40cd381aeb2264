"""Kinds of primitive, one class each: images of a set of primitives, their volume, and their part of the loss.

All kinds have the parameters of `recon.published_methods.paper.model.FactorisedGaussians`; fractions are not used.
"""

import math
from abc import ABC, abstractmethod

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


class Primitives(ABC):
    """One kind of primitive: its images, and the terms of the loss that do not depend on a view."""

    @abstractmethod
    def unit(self, units: Units) -> float:
        """Return the value that is 1 in an image of the normalised scene.

        Parameters
        ----------
        units : units of the channel

        Returns
        -------
        value of an image [no unit]
        """

    @abstractmethod
    def images(
        self, centres: Float[Tensor, "gaussian 3"], model: FactorisedGaussians, units: Units, geometry: Geometry
    ) -> Image:
        """Compute the images of a model in some views.

        Parameters
        ----------
        centres : centres in place of those of the model (x, y, z) [mm]
        model : primitives
        units : units of the channel
        geometry : poses of the views

        Returns
        -------
        images [no unit], differentiable
        """

    def penalty(
        self, model: FactorisedGaussians, grid: Grid, units: Units, recipe: PaperRecipe, rng: np.random.Generator
    ) -> Float[Tensor, ""] | float:
        """Compute the part of the loss that does not depend on a view: 0 unless a kind of primitive has one.

        Parameters
        ----------
        model : primitives
        grid : grid of the volume
        units : units of the channel
        recipe : weights
        rng : random numbers

        Returns
        -------
        part of the loss
        """
        return 0.0


class VolumePrimitives(Primitives):
    """One kind of primitive that attenuates."""

    def unit(self, units: Units) -> float:
        """Return the line integral that is 1 in the normalised scene.

        Parameters
        ----------
        units : units of the channel

        Returns
        -------
        line integral [no unit]
        """
        return units.line_integral

    @abstractmethod
    def volume(self, model: FactorisedGaussians, units: Units, grid: Grid) -> Float[np.ndarray, "z y x"]:
        """Compute attenuation on a grid.

        Parameters
        ----------
        model : primitives
        units : units of the channel
        grid : grid of the volume

        Returns
        -------
        volume [1/mm]
        """


class Attenuation(VolumePrimitives):
    """Gaussians of attenuation with the rectified local-affine footprint of R2-Gaussian, and its total variation."""

    def images(
        self, centres: Float[Tensor, "gaussian 3"], model: FactorisedGaussians, units: Units, geometry: Geometry
    ) -> Image:
        """Compute line integrals in some views.

        Parameters
        ----------
        centres : centres in place of those of the model (x, y, z) [mm]
        model : Gaussians
        units : units of the channel
        geometry : poses of the views

        Returns
        -------
        line integrals [no unit], differentiable
        """
        coefficients = units.density * model.density()
        parts = (centres, model.log_scales(units), model.quaternions, coefficients)
        return line_integrals(*parts, geometry, "local-affine")

    def penalty(
        self, model: FactorisedGaussians, grid: Grid, units: Units, recipe: PaperRecipe, rng: np.random.Generator
    ) -> Float[Tensor, ""]:
        """Compute the weighted total variation of a random patch of the volume.

        Parameters
        ----------
        model : Gaussians
        grid : grid of the volume
        units : units of the channel
        recipe : weight and size of the patch
        rng : random numbers for the position of the patch

        Returns
        -------
        part of the loss
        """
        parts = (model.centres, model.log_scales(units), model.quaternions, model.density())
        patch = patch_of_channels(*parts, torch.ones(1, 1), random_patch(grid, recipe.patch, rng))
        return recipe.volume_tv * total_variation(patch).sum()

    def volume(self, model: FactorisedGaussians, units: Units, grid: Grid) -> Float[np.ndarray, "z y x"]:
        """Compute attenuation on a grid.

        Parameters
        ----------
        model : Gaussians
        units : units of the channel
        grid : grid of the volume

        Returns
        -------
        volume [1/mm]
        """
        centres, log_scales, turns = (x.detach() for x in (model.centres, model.log_scales(units), model.quaternions))
        return voxelize(centres, log_scales, turns, units.density * model.density().detach(), grid)[0]


class Radiance(Primitives):
    """Gaussians of radiance: each adds its radiance times exp(-q/2) to an image, whatever the path length of a ray.

    A local-affine footprint has the height b sqrt(2 pi) / |S^-1 R^T e| for a ray with unit vector e through the centre.
    Divided by all but b, the height is the same from every side, whatever the path length. There is no volume that has
    these projections.
    """

    def unit(self, units: Units) -> float:
        """Return the radiance that is 1 in the normalised scene.

        Parameters
        ----------
        units : units of the channel, whose density is a radiance here

        Returns
        -------
        radiance [no unit]
        """
        return units.density

    def images(
        self, centres: Float[Tensor, "gaussian 3"], model: FactorisedGaussians, units: Units, geometry: Geometry
    ) -> Image:
        """Compute the sum of radiances in some views.

        Parameters
        ----------
        centres : centres in place of those of the model (x, y, z) [mm]
        model : Gaussians
        units : units of the channel
        geometry : poses of the views

        Returns
        -------
        log projections [no unit], differentiable
        """
        log_scales = model.log_scales(units)
        radiance = units.density * model.density()
        views = []
        for number, source in enumerate(torch.from_numpy(geometry.source).to(centres)):
            along = torch.nn.functional.normalize(centres.detach() - source, dim=1)
            height = math.sqrt(2 * math.pi) / _stretch(along, log_scales, model.quaternions)
            parts = (centres, log_scales, model.quaternions, radiance / height[:, None])
            views.append(line_integrals(*parts, geometry[number : number + 1], "local-affine"))
        return torch.cat(views)


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
