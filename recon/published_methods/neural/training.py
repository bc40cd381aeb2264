"""Settings and loop of all networks: Adam on the residuals of some rays per step, and volumes of a network."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, TypeAlias

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.published_methods.neural.networks import SEGMENT, Attenuation, FeatureGrids, Field, Perceptron
from recon.published_methods.neural.rays import RayNumbers, Rays
from recon.voxel.method import Images, Iteration, OnIteration, Volumes, Weights, no_callback
from spectra.threads import without_other_pools

# What rays measure (ray, channel), from values of a field at their points, the lengths of these, and their numbers.
Projection: TypeAlias = Callable[[Attenuation, Float[Tensor, "ray 1"], RayNumbers], Float[Tensor, "ray channel"]]

BRIGHTEST = 0.999  # quantile of the images that sets the unit of attenuation; our choice
VOXELS_AT_ONCE = 2**16  # voxels; piece of a volume that is computed at once, which limits memory
LAST_RATE = 0.1  # no unit; learning rate at the end over that at the start; our choice
BETAS = (0.9, 0.99)  # no unit; decay of the moments of Adam; Mueller et al. 2022, doi:10.1145/3528223.3530127
EPSILON = 1e-15  # no unit; constant of Adam that avoids division by zero; Mueller et al. 2022


def line_integrals_of(
    values: Attenuation, steps: Float[Tensor, "ray 1"], numbers: RayNumbers
) -> Float[Tensor, "ray channel"]:
    """Sum values along rays, a `Projection`.

    Parameters
    ----------
    values : of the field at the points of each ray [1/mm]
    steps : length that each point represents [mm]
    numbers : without effect

    Returns
    -------
    line integrals [no unit]
    """
    del numbers
    return values.sum(dim=1) * steps


@dataclass(frozen=True)
class TrainedField(ABC):
    """A network that computes attenuation from position, and how it is trained.

    Parameters
    ----------
    iterations : steps of Adam
    rays, points : rays per step (about), and points on each
    levels, coarsest, features : number of grids, nodes along an edge of the coarsest, and features per node; the finest
        has as many nodes along an edge as the volume has voxels
    hidden : width of the network
    rate, network_rate : first learning rates of features and network; they decrease to a tenth
    seed : seed of the first weights and the choice of rays
    """

    iterations: int = 1000
    rays: int = 1024
    points: int = 96
    levels: int = 6
    coarsest: int = 8
    features: int = 2
    hidden: int = 32
    rate: float = 0.1
    network_rate: float = 0.01
    seed: int = 0

    report_every: ClassVar[int]
    power: ClassVar[float] = 2.0  # no unit; of the residuals, whose mean is lowered

    @abstractmethod
    def network(self, inputs: int, outputs: int) -> nn.Module:
        """Create the network behind the grids of features.

        Parameters
        ----------
        inputs : number of features of a position
        outputs : number of channels or bases

        Returns
        -------
        network that computes raw outputs from features of points on lines
        """

    @abstractmethod
    def sampler(self, rays: Rays) -> Callable[[int], RayNumbers]:
        """Choose how rays are sampled.

        Parameters
        ----------
        rays : rays of the scan

        Returns
        -------
        function that chooses about a number of rays
        """

    def _field(self, outputs: int, units: Float[Tensor, " channel"], grid: Grid) -> Field:
        """Create a field with untrained weights."""
        encoding = FeatureGrids(self.levels, self.coarsest, max(grid.shape), self.features)
        return Field(encoding, self.network(encoding.width, outputs), units, self.seed)

    def _train(
        self,
        field: Field,
        rays: Rays,
        grid: Grid,
        on_iteration: OnIteration,
        project: Projection = line_integrals_of,
        volumes_of: Callable[[Volumes], Volumes] = lambda values: values,
    ) -> Volumes:
        """Fit a field to rays, and compute its volumes [1/mm]."""
        groups = [
            {"params": field.encoding.parameters(), "lr": self.rate},
            {"params": field.network.parameters(), "lr": self.network_rate},
        ]
        adam = torch.optim.Adam(groups, betas=BETAS, eps=EPSILON)
        decay = torch.optim.lr_scheduler.ExponentialLR(adam, LAST_RATE ** (1 / self.iterations))
        bright, choose = brightness(rays.images), self.sampler(rays)
        squares, whole, volumes = 0.0, 0.0, np.zeros((0, 0, 0, 0), np.float32)
        for step in range(1, self.iterations + 1):
            numbers = choose(self.rays)
            measured, points = rays.measured(numbers), rays.points(numbers, self.points)
            predicted = project(field(points.places), points.steps, numbers)
            loss = ((predicted - measured) / bright).abs().pow(self.power).mean()
            adam.zero_grad()
            loss.backward()
            adam.step()
            decay.step()
            squares += float((predicted.detach() - measured).square().sum())
            whole += float(measured.square().sum())
            if step % self.report_every == 0 or step == self.iterations:
                volumes = volumes_of(read(field, grid))
                residual = (squares / whole) ** 0.5 if whole > 0 else 0.0
                on_iteration(Iteration(step, self.iterations, residual, volumes))
                squares, whole = 0.0, 0.0
        return volumes


@dataclass(frozen=True)
class PerceptronField(TrainedField):
    """A perceptron behind the grids of features, trained on rays from anywhere.

    Parameters
    ----------
    layers : hidden layers of the perceptron
    """

    layers: int = 2

    report_every: ClassVar[int] = 20  # steps between two reports

    def network(self, inputs: int, outputs: int) -> nn.Module:
        """Create the perceptron.

        Parameters
        ----------
        inputs : number of features of a position
        outputs : number of outputs

        Returns
        -------
        perceptron
        """
        return Perceptron(inputs, self.hidden, self.layers, outputs)

    def sampler(self, rays: Rays) -> Callable[[int], RayNumbers]:
        """Choose rays anywhere.

        Parameters
        ----------
        rays : rays of the scan

        Returns
        -------
        function that chooses a number of rays
        """
        return rays.anywhere


@dataclass(frozen=True)
class CoordinateNetwork(TrainedField):
    """A network that is trained on line integrals, as a `recon.voxel.method.LinearMethod`."""

    @without_other_pools()
    def reconstruct(
        self,
        line_integrals: Images,
        weights: Weights | None,
        geometry: Geometry,
        grid: Grid,
        on_iteration: OnIteration = no_callback,
    ) -> Volumes:
        """Reconstruct volumes from line integrals.

        Parameters
        ----------
        line_integrals : one image per channel or basis and view [no unit]
        weights : 0 for rays that were not measured; all others have equal statistical weight
        geometry : poses of the views
        grid : grid of the volume
        on_iteration : called every few steps, with the relative residual ||b - A x|| / ||b|| of the rays in between

        Returns
        -------
        volumes [1/mm]
        """
        rays = Rays(line_integrals, weights, geometry, grid, self.seed)
        field = self._field(len(line_integrals), attenuation_units(line_integrals, grid), grid)
        return self._train(field, rays, grid, on_iteration)


def attenuation_units(images: Images, grid: Grid) -> Float[Tensor, " channel"]:
    """Compute the unit of attenuation of each channel: that of a bright ray over half of the longest edge.

    Parameters
    ----------
    images : line integrals [no unit]
    grid : grid of the volume

    Returns
    -------
    attenuation that is 1 for the network [1/mm]
    """
    return brightness(images) / _half_edge(grid)


def brightness(images: Images) -> Float[Tensor, " channel"]:
    """Compute the value of a bright ray of each channel.

    Parameters
    ----------
    images : values of all rays [no unit]

    Returns
    -------
    quantile `BRIGHTEST` of each channel; 1 where that is 0
    """
    bright = np.quantile(np.maximum(images, 0).reshape(len(images), -1), BRIGHTEST, axis=1)
    return torch.from_numpy(np.where(bright > 0, bright, 1.0)).float()


def _half_edge(grid: Grid) -> float:
    """Half the longest edge of a grid [mm]."""
    return max(n * spacing for n, spacing in zip(grid.shape, grid.spacing, strict=True)) / 2


@torch.no_grad()
def read(field: Callable[[Tensor], Tensor], grid: Grid) -> Volumes:
    """Compute attenuation at the centres of voxels; rows of voxels along x are the lines of a transformer.

    Parameters
    ----------
    field : network, or another function of positions
    grid : grid of the volume

    Returns
    -------
    volumes [1/mm]

    Notes
    -----
    Rows are continued beyond the last voxel until their number of points is a multiple of `SEGMENT`.
    """
    columns = -(-grid.shape[2] // SEGMENT) * SEGMENT
    x = (2 * torch.arange(columns) + 1) / grid.shape[2] - 1
    y, z = ((2 * torch.arange(n) + 1) / n - 1 for n in (grid.shape[1], grid.shape[0]))
    rows = torch.cartesian_prod(z, y)
    values = []
    for some in rows.split(max(VOXELS_AT_ONCE // columns, 1)):
        places = torch.stack([x.expand(len(some), -1), *some.flip(1).T[..., None].expand(2, -1, columns)], dim=-1)
        values.append(field(places)[:, : grid.shape[2]])
    return torch.cat(values).movedim(-1, 0).reshape(-1, *grid.shape).contiguous().numpy()
