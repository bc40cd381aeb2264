"""Gaussians together with what they cannot follow, kept in a few voxels."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Tensor

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.model import GaussianModel, Gaussians
from recon.ops.voxelize import CUTOFF
from recon.voxel.model import Voxels

RESIDUAL = ("places", "residual")  # arrays of the model beside those of its Gaussians


@dataclass(frozen=True, eq=False)
class GaussiansWithResidual(GaussianModel):
    """A sum of Gaussians, plain or divided by planes, and coefficients that are added in some voxels.

    Parameters
    ----------
    gaussians : the Gaussians
    places : indices of the voxels with a residual in the flattened grid, (K,), ascending
    residual : what is added to the coefficients there, (K, M), of either sign [1/mm]
    grid : the voxels

    Notes
    -----
    Line integrals of the residual are those of values at the centres of voxels, interpolated linearly.
    """

    gaussians: GaussianModel
    places: Int64[Tensor, " voxel"]
    residual: Float[Tensor, "voxel basis"]
    grid: Grid

    LEAST_CUTOFF: ClassVar = CUTOFF
    SCHEMA: ClassVar = "spectral-ct gaussians with residual 1.0"

    def __repr__(self) -> str:
        return f"GaussiansWithResidual({self.gaussians!r}, {len(self.places)} voxels)"

    @property
    def basis_names(self) -> tuple[str, ...]:  # type: ignore[override]
        """Names of the basis functions."""
        return self.gaussians.basis_names

    @property
    def centres(self) -> Float[Tensor, "gaussian 3"]:  # type: ignore[override]
        """Positions of the Gaussians [mm]."""
        return self.gaussians.centres

    @property
    def log_scales(self) -> Float[Tensor, "gaussian 3"]:  # type: ignore[override]
        """Logarithms of the standard deviations of the Gaussians [log mm]."""
        return self.gaussians.log_scales

    @property
    def coefficients(self) -> Float[Tensor, "gaussian *side basis"]:  # type: ignore[override]
        """Coefficients of the Gaussians [1/mm]."""
        return self.gaussians.coefficients

    @property
    def GEOMETRY(self) -> tuple[str, ...]:  # type: ignore[override]
        """Names of the arrays that place and shape the Gaussians."""
        return self.gaussians.GEOMETRY

    @property
    def SIGNED(self) -> bool:  # type: ignore[override]
        """Whether single coefficients of the Gaussians may be negative."""
        return self.gaussians.SIGNED

    @property
    def UNITS(self) -> dict[str, str]:  # type: ignore[override]
        """Units of the arrays."""
        return {**self.gaussians.UNITS, "residual": "1/mm", "grid": "mm"}

    @property
    def numbers(self) -> int:
        """Count the numbers that describe the model: those of the Gaussians, and 1 + M for each voxel."""
        return self.gaussians.numbers + self.residual.numel() + len(self.places)

    @cached_property
    def added(self) -> Voxels:
        """The residual on its grid."""
        values = np.zeros((len(self.basis_names), *self.grid.shape), np.float32)
        values.reshape(len(values), -1)[:, self.places.cpu().numpy()] = self.residual.detach().cpu().numpy().T
        return Voxels(values, self.grid, self.basis_names)

    def header(self) -> dict[str, Any]:
        """Collect what is no array.

        Returns
        -------
        header of the Gaussians, and the grid of the residual
        """
        grid = {"shape": self.grid.shape, "spacing": self.grid.spacing, "origin": self.grid.origin}
        return self.gaussians.header() | {"grid": grid}

    def tensors(self) -> dict[str, Tensor]:
        """Collect the arrays.

        Returns
        -------
        those of the Gaussians, then places and residual, by name
        """
        return self.gaussians.tensors() | {name: getattr(self, name) for name in RESIDUAL}

    def with_tensors(self, tensors: dict[str, Tensor]) -> "GaussiansWithResidual":
        """Make the same model of other arrays.

        Parameters
        ----------
        tensors : arrays by name; those that are missing stay

        Returns
        -------
        a model with these arrays
        """
        own = {name: value for name, value in tensors.items() if name in RESIDUAL}
        others = {name: value for name, value in tensors.items() if name not in RESIDUAL}
        return replace(self, gaussians=self.gaussians.with_tensors(others), **own)

    def part(self, which: Int64[Tensor, " some"]) -> "GaussiansWithResidual":
        """Select some of the Gaussians.

        Parameters
        ----------
        which : their indices

        Returns
        -------
        a model of these and of the whole residual
        """
        return replace(self, gaussians=self.gaussians.part(which))

    def voxels(self, grid: Grid, cutoff: float = CUTOFF) -> Float[Tensor, "basis z y x"]:
        """Compute the mean coefficient of each basis in every voxel.

        Parameters
        ----------
        grid : voxels to evaluate
        cutoff : where Gaussians end [standard deviations]

        Returns
        -------
        volumes, (M, Z, Y, X), differentiable in the arrays of the Gaussians [1/mm]
        """
        found = self.gaussians.voxels(grid, cutoff)
        return found + torch.from_numpy(self.added.volume(grid)).to(found)

    def volume(self, grid: Grid) -> Float[np.ndarray, "basis z y x"]:
        """Compute the mean coefficient of each basis in every voxel; means below 0 are set to 0.

        Parameters
        ----------
        grid : voxels to evaluate; on finer ones than its own, the residual is interpolated

        Returns
        -------
        volumes, (M, Z, Y, X), float32, not negative [1/mm]
        """
        return np.maximum(self.gaussians.volume(grid) + self.added.volume(grid), 0).astype(np.float32)

    def line_integrals(self, geometry: Geometry) -> Float[Tensor, "view basis row column"]:
        """Compute the line integrals of each basis, averaged over every pixel.

        Parameters
        ----------
        geometry : poses of the views, and the panel

        Returns
        -------
        line integrals, (V, M, R, K), differentiable in the arrays of the Gaussians [no unit]
        """
        found = self.gaussians.line_integrals(geometry)
        return found + self.added.line_integrals(geometry).to(found)

    def plain(self) -> Gaussians:
        """Describe the model by Gaussians alone, without the residual, for what knows nothing else.

        Returns
        -------
        Gaussians of the same mass, centre and covariance
        """
        return self.gaussians.plain()
