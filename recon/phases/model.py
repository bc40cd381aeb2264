"""Gaussians of all phases: one set of shapes, with coefficients and displacements of each phase."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.model import GaussianModel


@dataclass(frozen=True, eq=False)
class Lattice:
    """Nodes of a displacement, linear between them.

    Parameters
    ----------
    shape : nodes along x, y and z
    corners : nodes around each Gaussian
    weights : of these nodes, whose sum is 1
    """

    shape: tuple[int, int, int]
    corners: Int64[Tensor, "gaussian 8"]
    weights: Float[Tensor, "gaussian 8"]

    @classmethod
    def around(cls, centres: Float[Tensor, "gaussian 3"], spacing: float) -> "Lattice":
        """Make the nodes around some points.

        Parameters
        ----------
        centres : the points [mm]
        spacing : distance between nodes [mm]

        Returns
        -------
        the nodes
        """
        low = centres.min(dim=0).values
        place = (centres - low) / spacing
        first = place.floor().long()
        nx, ny, nz = (first.max(dim=0).values + 2).tolist()
        part = place - first
        corners, weights = [], []
        for corner in product((0, 1), repeat=3):
            x, y, z = (first + torch.tensor(corner)).unbind(dim=1)
            corners.append((x * ny + y) * nz + z)
            chosen = torch.where(torch.tensor(corner, dtype=torch.bool), part, 1 - part)
            weights.append(chosen.prod(dim=1))
        return cls((nx, ny, nz), torch.stack(corners, dim=1), torch.stack(weights, dim=1))

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return self.shape[0] * self.shape[1] * self.shape[2]

    def at_gaussians(self, values: Float[Tensor, "node 3"]) -> Float[Tensor, "gaussian 3"]:
        """Interpolate values of the nodes.

        Parameters
        ----------
        values : at the nodes

        Returns
        -------
        values at the Gaussians
        """
        return torch.einsum("gk,gkd->gd", self.weights, values[self.corners])

    def to_nodes(self, values: Float[Tensor, "gaussian 3"]) -> Float[Tensor, "node 3"]:
        """Add up values of Gaussians at the nodes, the adjoint of `at_gaussians`.

        Parameters
        ----------
        values : at the Gaussians

        Returns
        -------
        sums at the nodes
        """
        spread = (self.weights[:, :, None] * values[:, None]).reshape(-1, 3)
        return torch.zeros(self.nodes, 3).index_add_(0, self.corners.reshape(-1), spread)

    def smoothed(self, values: Float[Tensor, "node 3"]) -> Float[Tensor, "node 3"]:
        """Average each node with the six around it.

        Parameters
        ----------
        values : at the nodes

        Returns
        -------
        means; at the border the node itself stands for the ones that are missing
        """
        field = values.reshape(*self.shape, 3)
        total = torch.zeros_like(field)
        for axis in range(3):
            one, size = field.movedim(axis, 0), self.shape[axis]
            after = torch.cat([one[1:], one[size - 1 :]])
            before = torch.cat([one[:1], one[: size - 1]])
            total += (after + before).movedim(0, axis)
        return (total / 6).reshape(-1, 3)


class Alone(NamedTuple):
    """Fit of a phase alone.

    Parameters
    ----------
    gaussians : fitted model
    weight : of this model in the mean with the phase fitted together with the others, above 0 and at most 1 [no unit]
    """

    gaussians: GaussianModel
    weight: float


@dataclass(frozen=True, eq=False)
class PhaseGaussians:
    """Gaussians of all phases.

    Parameters
    ----------
    shared : shapes, and the places that displacements start from
    coefficients : of each phase [1/mm]
    displacements : of the nodes in each phase [mm]
    lattice : the nodes
    alone : fits of phases alone, by the number of the phase, where they have a part in its volumes
    """

    shared: GaussianModel
    coefficients: Float[Tensor, "phase gaussian *side basis"]
    displacements: Float[Tensor, "phase node 3"]
    lattice: Lattice
    alone: Mapping[int, Alone] = field(default_factory=dict)

    @classmethod
    def begin(
        cls, shared: GaussianModel, coefficients: Float[Tensor, "phase gaussian *side basis"], spacing: float
    ) -> "PhaseGaussians":
        """Make phases that are not displaced.

        Parameters
        ----------
        shared : model of the mean of all phases
        coefficients : of each phase [1/mm]
        spacing : distance between nodes of the displacement [mm]

        Returns
        -------
        the phases
        """
        lattice = Lattice.around(shared.centres.detach(), spacing)
        return cls(shared.detached(), coefficients, torch.zeros(len(coefficients), lattice.nodes, 3), lattice)

    def __len__(self) -> int:
        return len(self.coefficients)

    def at(self, phase: int) -> GaussianModel:
        """Return the Gaussians of one phase that were fitted together with those of the others.

        Parameters
        ----------
        phase : its number

        Returns
        -------
        an ordinary model
        """
        moved = self.shared.centres + self.lattice.at_gaussians(self.displacements[phase])
        return self.shared.with_tensors({"centres": moved, "coefficients": self.coefficients[phase].clone()})

    def volumes(self, grid: Grid) -> Float[np.ndarray, "phase basis z y x"]:
        """Compute the basis volumes of all phases.

        Parameters
        ----------
        grid : the voxels

        Returns
        -------
        means over voxels [1/mm]
        """
        return np.stack([self.volume(phase, grid) for phase in range(len(self))])

    def volume(self, phase: int, grid: Grid) -> Float[np.ndarray, "basis z y x"]:
        """Compute the basis volumes of one phase, the weighted mean of both fits where it was fitted alone, too.

        Parameters
        ----------
        phase : its number
        grid : the voxels

        Returns
        -------
        means over voxels [1/mm]
        """
        together = self.at(phase).volume(grid)
        if phase not in self.alone:
            return together
        gaussians, weight = self.alone[phase]
        return together + np.float32(weight) * (gaussians.volume(grid) - together)
