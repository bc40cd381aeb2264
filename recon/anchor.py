"""A prior that holds the Gaussians near volumes which a total variation has made smooth where they should be.

The likelihood alone lets neighbouring Gaussians trade coefficients against each other, which shows as noise, most in
Compton, and as ripples where few rays look along a face. Voxels with a joint total variation
(`recon.baselines.one_step`) know better there, while Gaussians know better where edges lie. So the fit minimises half
the deviance plus half the squared distance of its volumes from those voxels, weighted by the information that the data
have about the coefficients, averaged over all Gaussians, times a strength.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from phantomgen.grid import Grid
from recon.gaussians import Gaussians
from recon.ops.voxelize import voxelize, voxelize_tensor

SLABS = 4  # parts of the volume that take turns, one each step
_STRIDE = 3  # so that slabs which follow each other do not touch


@dataclass(frozen=True, eq=False)
class Anchor:
    """Volumes to stay near.

    Parameters
    ----------
    volumes : [1/mm]
    grid : their voxels
    strength : information of the prior over that of the data
    """

    volumes: Float[np.ndarray, "basis z y x"]
    grid: Grid
    strength: float

    def curvature(
        self, gaussians: Gaussians, blocks: Float[Tensor, "gaussian basis basis"]
    ) -> tuple[Float[Tensor, "gaussian basis basis"], Float[Tensor, "basis basis"]]:
        """Curvature of likelihood and prior together, and the weight of a voxel's squared distance.

        Parameters
        ----------
        gaussians : the model
        blocks : curvature of the likelihood, see `recon.curvature`; the same separable majoriser is made of the prior
        """
        parts = (gaussians.centres.detach(), gaussians.log_scales.detach(), gaussians.quaternions.detach())
        one = torch.ones(len(gaussians), 1, requires_grad=True)
        crowd = torch.from_numpy(voxelize(*parts, one.detach(), self.grid))
        voxelize_tensor(*parts, one, self.grid).backward(crowd)
        assert one.grad is not None
        share = one.grad[:, :, None]
        weight = self.strength * blocks.sum(dim=0) / share.sum().clamp_min(1e-30)
        return blocks + share * weight, weight

    def add_gradients(self, gaussians: Gaussians, weight: Float[Tensor, "basis basis"], step: int) -> None:
        """Add the gradients of half the weighted squared distance in the slab whose turn it is, times `SLABS`.

        Parameters
        ----------
        gaussians : the model, whose tensors have gradients
        weight : of the squared distance, in units of the loss
        step : counts up
        """
        depth = self.grid.shape[0]
        slabs = min(SLABS, depth)
        k = step * _STRIDE % slabs
        first, last = k * depth // slabs, (k + 1) * depth // slabs
        slab = self.grid.slices(first, last - first)
        found = voxelize_tensor(
            gaussians.centres, gaussians.log_scales, gaussians.quaternions, gaussians.coefficients, slab
        )
        away = found.detach() - torch.from_numpy(self.volumes[:, first:last])
        found.backward(torch.einsum("mn,nzyx->mzyx", slabs * weight, away))
