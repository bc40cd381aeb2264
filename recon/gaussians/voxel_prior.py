"""A prior that holds the Gaussians near volumes which a total variation has made smooth where they should be.

The likelihood alone lets neighbouring Gaussians trade coefficients against each other, which shows as noise, most in
Compton, and as ripples where few rays look along a face. Voxels with a joint total variation
(`recon.voxel.iterative.one_step`) know better there, while Gaussians know better where edges lie. So the fit minimises
half the deviance plus half the squared distance of its volumes from those voxels, weighted by the information that the
data have about the coefficients, averaged over all Gaussians, times a strength. Along edges, which voxels blur, only a
part of that weight counts, and next to none at metal: voxels err in proportion to what they hold, and rays know little.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.ndimage import maximum_filter
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.data.volume_edges import VolumeEdges, metal_without_agents, over_metal
from recon.gaussians.model import Gaussians
from recon.ops.voxelize import mass_within, voxelize_tensor

CUTOFF = 3.5  # standard deviations
SLABS = 8  # parts of the volume that take turns, one each step
_STRIDE = 3  # so that slabs which follow each other do not touch
_BESIDE = 3  # voxels across that an edge reaches


@dataclass(frozen=True, eq=False)
class VoxelPrior:
    """Volumes to stay near.

    Parameters
    ----------
    volumes : [1/mm]
    grid : their voxels
    strength : information of the prior over that of the data, where weights are 1
    weights : of the voxels, 1 where the volumes are to be trusted
    metal : density over that of the least dense metal, at least 1; None where it does not matter
    """

    volumes: Float[np.ndarray, "basis z y x"]
    grid: Grid
    strength: float
    weights: Float[np.ndarray, "z y x"]
    metal: Float[np.ndarray, "z y x"] | None = None

    @classmethod
    def off_edges(
        cls,
        volumes: Float[np.ndarray, "basis z y x"],
        grid: Grid,
        fisher: Float[np.ndarray, "basis basis"],
        strength: float,
        along: float,
    ) -> "VoxelPrior":
        """Volumes to be trusted where they have no edges.

        Parameters
        ----------
        volumes : [1/mm]
        grid : their voxels
        fisher : mean Fisher matrix of the rays' line integrals, in whose noise edges are measured
        strength : information of the prior over that of the data
        along : weight on an edge over that far from all of them
        """
        edge = maximum_filter(np.clip(VolumeEdges.of(volumes, fisher).strength, 0, 1), size=_BESIDE)
        trusted = np.maximum(1 - edge, along / over_metal(volumes) ** 4)
        return cls(volumes, grid, strength, trusted.astype(np.float32))

    def holding(self, names: tuple[str, ...]) -> "VoxelPrior":
        """The same, which holds the K edges among bases of such names where there is metal (`agents_in_metal`)."""
        return replace(self, metal=metal_without_agents(self.volumes, names)[1])

    def agents_in_metal(self, gaussians: Gaussians) -> Bool[Tensor, "gaussian basis"] | None:
        """Which coefficients stay as the volumes have them: those of K edges in metal; None where there are none.

        What no mixture of bases explains in metal would become a contrast agent there, as the prior lets go of metal.
        """
        if self.metal is None or self.metal.max(initial=1) <= 1:
            return None
        edges = metal_without_agents(self.volumes[:, :1, :1, :1], gaussians.basis_names)[0]
        place = gaussians.centres.detach().cpu().numpy()[:, ::-1] - np.array(self.grid.origin)
        index = np.round(place / np.array(self.grid.spacing)).astype(int)
        index = np.clip(index, 0, np.array(self.grid.shape) - 1)
        dense = self.metal[tuple(index.T)] > 1
        return torch.from_numpy(dense[:, None] & edges).to(gaussians.centres.device)

    def curvature(
        self, gaussians: Gaussians, blocks: Float[Tensor, "gaussian basis basis"]
    ) -> tuple[Float[Tensor, "gaussian basis basis"], Float[Tensor, "basis basis"]]:
        """Curvature of likelihood and prior together, and the weight of a voxel's squared distance.

        Parameters
        ----------
        gaussians : the model
        blocks : curvature of the likelihood, see `recon.gaussians.fisher`; the same separable majoriser is made of the
            prior
        """
        parts = (gaussians.centres.detach(), gaussians.log_scales.detach(), gaussians.quaternions.detach())
        one = torch.ones_like(gaussians.coefficients[:, :1]).detach()
        crowd = voxelize_tensor(*parts, one, self.grid)
        everywhere = float(torch.sum(crowd * crowd, dtype=torch.float64))
        weight = self.strength * blocks.sum(dim=0) / max(everywhere, 1e-30)
        one.requires_grad_()
        voxelize_tensor(*parts, one, self.grid).backward(crowd * torch.from_numpy(self.weights).to(crowd))
        assert one.grad is not None
        return blocks + one.grad[:, :, None] * weight, weight

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
        near = _reaching(gaussians, slab)
        centres, log_scales, quaternions, coefficients = (
            part.index_select(0, near) for part in gaussians.tensors().values()
        )
        found = voxelize_tensor(centres, log_scales, quaternions, coefficients, slab, cutoff=CUTOFF)
        away = found.detach() - mass_within(CUTOFF) * torch.from_numpy(self.volumes[:, first:last]).to(found)
        away *= torch.from_numpy(self.weights[first:last]).to(found)
        found.backward(torch.einsum("mn,nzyx->mzyx", slabs * weight, away))


def _reaching(gaussians: Gaussians, slab: Grid) -> Tensor:
    """Indices of the Gaussians that may reach into the slab, in order."""
    across, height = slab.spacing[0], slab.spacing[0] * slab.shape[0]
    middle = slab.origin[0] + 0.5 * (height - across)
    widest = torch.exp(2 * gaussians.log_scales.detach().amax(dim=1))
    reach = CUTOFF * torch.sqrt(widest + across**2 / 12) + across
    return torch.nonzero((gaussians.centres.detach()[:, 2] - middle).abs() < 0.5 * height + reach)[:, 0]
