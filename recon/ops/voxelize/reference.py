"""Sum of Gaussians on a voxel grid, dense and in float64: the truth that the kernel is tested against."""

import torch
from jaxtyping import Float
from torch import Tensor

from recon.ops.rasterize.reference import lattice_mass, rotation


def voxelize(
    centres: Float[Tensor, "gaussian 3"],
    log_scales: Float[Tensor, "gaussian 3"],
    quaternions: Float[Tensor, "gaussian 4"],
    coefficients: Float[Tensor, "gaussian basis"],
    axes: tuple[Float[Tensor, " z"], Float[Tensor, " y"], Float[Tensor, " x"]],
    voxel: tuple[float, float, float],
) -> Float[Tensor, "basis z y x"]:
    """Compute the value of every basis in voxels, averaged over them.

    Parameters
    ----------
    centres, log_scales, quaternions, coefficients : as in `recon.ops.voxelize.voxelize`
    axes : voxel centres along z, y and x [mm]
    voxel : edges of a voxel along z, y and x [mm]

    Returns
    -------
    volumes [1/mm]

    Notes
    -----
    Averaging over a box adds edge^2 / 12 to the covariance along each axis and keeps the mass, also of a Gaussian that
    is too narrow for the voxels to sample evenly.
    """
    turn = rotation(quaternions)
    narrow = turn @ torch.diag_embed(torch.exp(2 * log_scales)) @ turn.mT
    wide = narrow + torch.diag(torch.tensor(voxel[::-1], dtype=narrow.dtype) ** 2 / 12)
    mass_kept = torch.sqrt(torch.linalg.det(narrow) / torch.linalg.det(wide))
    pitch, first = torch.tensor(voxel[::-1], dtype=narrow.dtype), torch.stack([axis[0] for axis in reversed(axes)])
    mass_kept = mass_kept / lattice_mass((centres - first) / pitch, wide / (pitch[:, None] * pitch))
    z, y, x = torch.meshgrid(*axes, indexing="ij")
    delta = torch.stack([x, y, z], -1)[..., None, :] - centres
    square = torch.einsum("zyxni,nij,zyxnj->zyxn", delta, torch.linalg.inv(wide), delta)
    return torch.einsum("zyxn,n,nm->mzyx", torch.exp(-square / 2), mass_kept, coefficients)
