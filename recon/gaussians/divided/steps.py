"""Steps of divided Gaussians, each in the frame of its own axes: ten of the geometry, then one per side and basis.

They are moves along the axes with the plane held in space [mm], changes of the log-scales [no unit], rotations about
the axes, with the plane, [rad], moves of the plane [mm], and changes of the coefficients [1/mm].
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from recon.gaussians.divided.model import DividedGaussians
from recon.gaussians.initial.local_frame import rotations, turns, unit

SCALES, TURNS, PLANE = slice(3, 6), slice(6, 9), 9  # where the steps of scales, rotations and planes are
GEOMETRY = 10  # steps before those of the coefficients
LEAST_PLANE = 1e-4  # no unit; curvature along a move of the plane over that along a move of the Gaussian, at least


def gradient_of_steps(model: DividedGaussians, gradients: Sequence[Tensor]) -> Float[Tensor, "gaussian step"]:
    """Convert gradients with respect to the arrays of a model into those with respect to steps from it.

    Parameters
    ----------
    model : the model
    gradients : gradients with respect to centres, log-scales, quaternions, offsets and coefficients

    Returns
    -------
    gradient with respect to the 10 + 2 M steps of each Gaussian
    """
    centres, log_scales, quaternions, offsets, coefficients = gradients
    turned = unit(model.quaternions)
    along = torch.einsum("gij,gi->gj", rotations(turned), centres)
    along[:, 2] -= offsets
    per_unit = quaternions * model.quaternions.norm(dim=1, keepdim=True)
    about = torch.einsum("gqk,gq->gk", turns(turned), per_unit)
    return torch.cat([along, log_scales, about, offsets[:, None], coefficients.flatten(1)], dim=1)


def moved(model: DividedGaussians, steps: Float[Tensor, "gaussian step"]) -> DividedGaussians:
    """Make steps.

    Parameters
    ----------
    model : the model
    steps : the 10 + 2 M steps of each Gaussian

    Returns
    -------
    the model after these steps
    """
    turned = unit(model.quaternions)
    turn = torch.einsum("gqk,gk->gq", turns(turned), steps[:, TURNS])
    return replace(
        model,
        centres=model.centres + torch.einsum("gij,gj->gi", rotations(turned), steps[:, :3]),
        log_scales=model.log_scales + steps[:, SCALES],
        quaternions=unit(turned + turn),
        offsets=model.offsets - steps[:, 2] + steps[:, PLANE],
        coefficients=model.coefficients + steps[:, GEOMETRY:].reshape(model.coefficients.shape),
    )


def curvature_of_geometry(
    model: DividedGaussians,
    metric: Float[Tensor, "basis basis"],
    voxel: float,
    overlap: Float[Tensor, " gaussian"],
    least_energy: float,
    least_turning: float,
) -> Float[Tensor, "gaussian 10"]:
    """Compute the curvature of a squared distance of volumes along each step of the geometry.

    Parameters
    ----------
    model : the model
    metric : weights of the bases [mm^2]
    voxel : edge of a voxel [mm]
    overlap : sum over voxels of each Gaussian times the sum of all Gaussians [no unit]
    least_energy : part of the mean squared coefficient of all Gaussians that is added to that of each [no unit]
    least_turning : curvature along a rotation of a round Gaussian over that of an elongated one [no unit]

    Returns
    -------
    curvatures

    Notes
    -----
    Those of the Gaussian are as in `recon.gaussians.initial.fit_to_volume`, for the mean square of both sides. A move
    of the plane by d changes the density by (b_2 - b_1) g phi(q) d with a normal density phi of variance w^2, that of
    the transition and of the voxel. As phi^2 is 1 / (2 sqrt(pi) w) times a normal density, the integral of the square
    is (b_2 - b_1)^2 / (2 sqrt(pi) w) times that of g^2 over the plane, which is exp(-o^2 / t) / sqrt(pi t) times that
    over space, with the plane's offset o and the variance t of the Gaussian along the normal. A rotation moves the
    plane by the distance from the centre, whose mean square under g^2 is half the variance.
    """
    sides = model.coefficients.unbind(1)
    power = 0.5 * sum(torch.einsum("gm,mn,gn->g", side, metric, side) for side in sides)
    jumps = torch.einsum("gm,mn,gn->g", sides[1] - sides[0], metric, sides[1] - sides[0])
    floor = least_energy * (power + jumps).mean()
    variance = torch.exp(2 * model.log_scales)
    seen = variance + voxel**2 / 12
    own = variance / seen  # the rest is that of the voxel
    left, right = seen.roll(-1, dims=1), seen.roll(-2, dims=1)
    energy = (overlap * (power + floor))[:, None]
    moves = energy * 0.5 / seen
    scales = energy * ((1 - own) ** 2 + (1 - own) * own + 0.75 * own**2)
    turning = energy * ((left - right) ** 2 / (4 * left * right) + least_turning)
    width = math.sqrt(model.width**2 + voxel**2 / 12)
    on_plane = torch.exp(-(model.offsets**2) / seen[:, 2]) / torch.sqrt(math.pi * seen[:, 2])
    plane = (overlap * (jumps + floor) * on_plane)[:, None] / (2 * math.sqrt(math.pi) * width)
    turning[:, :2] += plane * 0.5 * seen[:, [1, 0]]
    return torch.cat([moves, scales, turning, plane + LEAST_PLANE * moves[:, 2:]], dim=1)
