"""Steps of Gaussians, each in the frame of its own axes: nine of the geometry, then one per basis.

They are moves along the axes [mm], changes of the log-scales [no unit], rotations about the axes [rad], and changes of
the coefficients [1/mm]. In this frame the curvature of a Gaussian is close to diagonal, which an optimizer can use.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from recon.gaussians.model import Gaussians

SCALES = slice(3, 6)  # steps of the log-scales
GEOMETRY = 9  # steps before those of the coefficients


def gradient_of_steps(gaussians: Gaussians, gradients: Sequence[Tensor]) -> Float[Tensor, "gaussian step"]:
    """Convert gradients with respect to the arrays of a model into those with respect to steps from it.

    Parameters
    ----------
    gaussians : the model
    gradients : gradients with respect to centres, log-scales, quaternions and coefficients

    Returns
    -------
    gradient with respect to the 9 + M steps of each Gaussian
    """
    centres, log_scales, quaternions, coefficients = gradients
    turned = unit(gaussians.quaternions)
    along = torch.einsum("gij,gi->gj", rotations(turned), centres)
    per_unit = quaternions * gaussians.quaternions.norm(dim=1, keepdim=True)
    about = torch.einsum("gqk,gq->gk", turns(turned), per_unit)
    return torch.cat([along, log_scales, about, coefficients], dim=1)


def moved(gaussians: Gaussians, steps: Float[Tensor, "gaussian step"]) -> Gaussians:
    """Make steps; coefficients that would become negative become 0.

    Parameters
    ----------
    gaussians : the model
    steps : the 9 + M steps of each Gaussian

    Returns
    -------
    the model after these steps
    """
    turned = unit(gaussians.quaternions)
    turn = torch.einsum("gqk,gk->gq", turns(turned), steps[:, 6:9])
    return replace(
        gaussians,
        centres=gaussians.centres + torch.einsum("gij,gj->gi", rotations(turned), steps[:, :3]),
        log_scales=gaussians.log_scales + steps[:, SCALES],
        quaternions=unit(turned + turn),
        coefficients=(gaussians.coefficients + steps[:, GEOMETRY:]).clamp(min=0),
    )


def unit(quaternions: Float[Tensor, "gaussian 4"]) -> Float[Tensor, "gaussian 4"]:
    """Divide quaternions by their length."""
    return quaternions / quaternions.norm(dim=1, keepdim=True)


def rotations(quaternions: Float[Tensor, "gaussian 4"]) -> Float[Tensor, "gaussian 3 3"]:
    """Compute the matrices, whose columns are the axes, of unit quaternions."""
    w, x, y, z = quaternions.unbind(dim=1)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)


def turns(quaternions: Float[Tensor, "gaussian 4"]) -> Float[Tensor, "gaussian 4 3"]:
    """Compute the change of a unit quaternion per rotation about each of its own axes."""
    w, x, y, z = quaternions.unbind(dim=1)
    rows = ((-x, -y, -z), (w, -z, y), (z, w, -x), (-y, x, w))
    return 0.5 * torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)
