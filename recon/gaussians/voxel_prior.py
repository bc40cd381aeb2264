"""The voxel prior: a term of the objective that keeps the Gaussians close to the volumes they started from.

The likelihood alone lets neighbouring Gaussians exchange their coefficients, which shows as noise, most of all in
Compton scattering, and as ripples along faces that few rays graze. Voxels with a joint total variation
(`recon.voxel.iterative.one_step`) are better there, while Gaussians are better where edges lie. `VoxelPrior` is the
term F_prior of `recon.gaussians.objective`, which has its equation; it computes the trust w of the voxels, the metric W
and the gradients. Along edges, which voxels blur, the trust is low, and next to none at metal, where voxels err in
proportion to what they hold and rays have little information.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.ndimage import maximum_filter
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.data.volume_edges import VolumeEdges, metal_without_agents, over_metal
from recon.gaussians.model import GaussianModel
from recon.gaussians.settings import PriorSettings
from recon.ops.voxelize import mass_within

if TYPE_CHECKING:
    from recon.gaussians.on_curve.directions import AlongCurve

DEFAULT = PriorSettings()


@dataclass(frozen=True, eq=False)
class VoxelPrior:
    """Volumes that a fit stays close to.

    Parameters
    ----------
    volumes : mu0, (M, Z, Y, X) [1/mm]
    grid : voxels of the volumes
    strength : lambda, information of the prior over that of the data where the trust is 1 [no unit]
    trust : w of each voxel, 0 to 1 [no unit]
    metal : density over that of the least dense metal, at least 1 [no unit]; None where no coefficients are held
    on_curve : where on a curve of materials the volumes are; None for coefficients of all bases
    settings : how the term is evaluated
    """

    volumes: Float[np.ndarray, "basis z y x"]
    grid: Grid
    strength: float
    trust: Float[np.ndarray, "z y x"]
    metal: Float[np.ndarray, "z y x"] | None = None
    on_curve: "AlongCurve | None" = None
    settings: PriorSettings = DEFAULT

    @classmethod
    def of_volumes(
        cls,
        volumes: Float[np.ndarray, "basis z y x"],
        grid: Grid,
        fisher: Float[np.ndarray, "basis basis"],
        strength: float,
        trust_along_edges: float,
        settings: PriorSettings = DEFAULT,
    ) -> "VoxelPrior":
        """Make a prior that trusts volumes far from edges, less along edges, and least at metal.

        Parameters
        ----------
        volumes : mu0, (M, Z, Y, X) [1/mm]
        grid : voxels of the volumes
        fisher : mean Fisher matrix of the rays' line integrals, which gives the noise that edges are compared with
        strength : lambda, information of the prior over that of the data [no unit]
        trust_along_edges : a, trust on an edge over that far from all edges [no unit]
        settings : width of edges, and power of the density

        Returns
        -------
        prior with w = max(1 - edge, a / density^power)
        """
        edge = maximum_filter(np.clip(VolumeEdges.of(volumes, fisher).strength, 0, 1), size=settings.edge_width)
        trust = np.maximum(1 - edge, trust_along_edges / over_metal(volumes) ** settings.metal_power)
        return cls(volumes, grid, strength, trust.astype(np.float32), settings=settings)

    def holding_kedges(self, names: tuple[str, ...]) -> "VoxelPrior":
        """Make a prior that also holds the coefficients of K edges in metal (`held_coefficients`).

        Parameters
        ----------
        names : names of the bases, of which those of K edges begin with ``kedge``

        Returns
        -------
        the same prior, which knows where there is metal
        """
        return replace(self, metal=metal_without_agents(self.volumes, names)[1])

    def held_coefficients(self, gaussians: GaussianModel) -> Bool[Tensor, "gaussian *side basis"] | None:
        """Find the coefficients that keep the values of the volumes: those of K edges in metal.

        No mixture of basis functions attenuates as metal does. What is missing would become a contrast agent there,
        because the trust in the volumes is low at metal.

        Parameters
        ----------
        gaussians : the model

        Returns
        -------
        True where a coefficient is held; None where there is no metal
        """
        if self.metal is None or self.metal.max(initial=1) <= 1:
            return None
        edges = metal_without_agents(self.volumes[:, :1, :1, :1], gaussians.basis_names)[0]
        place = gaussians.centres.detach().cpu().numpy()[:, ::-1] - np.array(self.grid.origin)
        index = np.round(place / np.array(self.grid.spacing)).astype(int)
        index = np.clip(index, 0, np.array(self.grid.shape) - 1)
        dense = self.metal[tuple(index.T)] > 1
        return torch.from_numpy(dense.reshape(-1, *[1] * (gaussians.coefficients.ndim - 1)) & edges).to(
            gaussians.centres.device
        )

    def curvature(
        self, gaussians: GaussianModel, blocks: Float[Tensor, "gaussian *side basis basis"]
    ) -> tuple[Float[Tensor, "gaussian *side basis basis"], Float[Tensor, "basis basis"]]:
        """Compute the metric W, and the curvature of both terms in the coefficients.

        Parameters
        ----------
        gaussians : the model
        blocks : curvature H_i of the data term, see `recon.gaussians.fisher` [mm^2]

        Returns
        -------
        blocks of the data term plus the separable majoriser of the prior's curvature [mm^2]; the metric W [mm^2]
        """
        one = torch.ones_like(gaussians.coefficients[..., :1]).detach()
        density = gaussians.with_values(one).voxels(self.grid)
        everywhere = float(torch.sum(density * density, dtype=torch.float64))
        metric = self.strength * blocks.flatten(0, -3).sum(dim=0) / max(everywhere, 1e-30)
        one.requires_grad_()
        gaussians.with_values(one).voxels(self.grid).backward(density * torch.from_numpy(self.trust).to(density))
        assert one.grad is not None
        return blocks + one.grad[..., None] * metric, metric

    def add_gradients(self, gaussians: GaussianModel, metric: Float[Tensor, "basis basis"], step: int) -> None:
        """Add the gradients of the prior in one slab of the volume, times the number of slabs.

        The mean over as many steps as there are slabs is the gradient of the whole term.

        Parameters
        ----------
        gaussians : the model, whose arrays have gradients
        metric : W, divided by what the objective is divided by
        step : number of the step, which selects the slab
        """
        depth, cutoff = self.grid.shape[0], max(self.settings.cutoff, gaussians.LEAST_CUTOFF)
        slabs = min(self.settings.slabs, depth)
        k = step * self.settings.slab_stride % slabs
        first, last = k * depth // slabs, (k + 1) * depth // slabs
        slab = self.grid.slices(first, last - first)
        near = _reaching(gaussians, slab, cutoff)
        found = gaussians.part(near).voxels(slab, cutoff)
        difference = found.detach() - mass_within(cutoff) * torch.from_numpy(self.volumes[:, first:last]).to(found)
        difference *= torch.from_numpy(self.trust[first:last]).to(found)
        found.backward(torch.einsum("mn,nzyx->mzyx", slabs * metric, difference))


def _reaching(gaussians: GaussianModel, slab: Grid, cutoff: float) -> Tensor:
    """Find the indices of the Gaussians that may reach into a slab, in order."""
    across, height = slab.spacing[0], slab.spacing[0] * slab.shape[0]
    middle = slab.origin[0] + 0.5 * (height - across)
    widest = torch.exp(2 * gaussians.log_scales.detach().amax(dim=1))
    reach = cutoff * torch.sqrt(widest + across**2 / 12) + across
    return torch.nonzero((gaussians.centres.detach()[:, 2] - middle).abs() < 0.5 * height + reach)[:, 0]
