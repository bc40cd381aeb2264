"""Steps of divided Gaussians in the frame of their own axes, and the curvature along each.

Ten of the geometry: moves along the axes with the plane held in space [mm], changes of the log-scales, rotations about
the axes [rad], and moves of the plane [mm]; then the coefficients.
"""

import math

import torch
from dataclasses import replace
from torch import Tensor

from recon.gaussians.initial.local_frame import _rotations, _turns, _unit
from recon.gaussians.interface.model import DividedGaussians

GEOMETRY = 10


def gradient_of_steps(model: DividedGaussians, gradients) -> Tensor:
    centres, log_scales, quaternions, offsets, coefficients = gradients
    turned = _unit(model.quaternions)
    along = torch.einsum("gij,gi->gj", _rotations(turned), centres)
    along[:, 2] -= offsets  # the plane stays
    per_unit = quaternions * model.quaternions.norm(dim=1, keepdim=True)
    about = torch.einsum("gqk,gq->gk", _turns(turned), per_unit)
    return torch.cat([along, log_scales, about, offsets[:, None], coefficients.flatten(1)], dim=1)


def moved(model: DividedGaussians, steps: Tensor, signed: bool = False) -> DividedGaussians:
    turned = _unit(model.quaternions)
    turn = torch.einsum("gqk,gk->gq", _turns(turned), steps[:, 6:9])
    coefficients = model.coefficients + steps[:, GEOMETRY:].reshape(model.coefficients.shape)
    return replace(
        model,
        centres=model.centres + torch.einsum("gij,gj->gi", _rotations(turned), steps[:, :3]),
        log_scales=model.log_scales + steps[:, 3:6],
        quaternions=_unit(turned + turn),
        offsets=model.offsets - steps[:, 2] + steps[:, 9],
        coefficients=coefficients if signed else coefficients.clamp(min=0),
    )


def curvatures(model: DividedGaussians, metric: Tensor, voxel: float, energy: Tensor, overlap: Tensor, least: float) -> Tensor:
    """Diagonal along the steps of the geometry; `energy` (N, 2): overlap with all Gaussians, per side."""
    mean = 0.5 * (model.coefficients[:, 0] + model.coefficients[:, 1])
    power = 0.5 * sum(torch.einsum("gm,mn,gn->g", b, metric, b) for b in model.coefficients.unbind(1))
    jump = model.coefficients[:, 1] - model.coefficients[:, 0]
    jumps = torch.einsum("gm,mn,gn->g", jump, metric, jump)
    variance = torch.exp(2 * model.log_scales)
    seen = variance + voxel**2 / 12
    own = variance / seen
    left, right = seen.roll(-1, 1), seen.roll(-2, 1)
    floor = least * (power + jumps).mean()
    total = (energy * (power + floor))[:, None]
    plain = torch.cat(
        [0.5 / seen, (1 - own) ** 2 + (1 - own) * own + 0.75 * own**2, (left - right) ** 2 / (4 * left * right) + 0.01], 1
    )
    # the plane: int (db phi(q) g)^2, with the square of a normal density of width w, which is 1 / (2 sqrt(pi) w)
    w = math.sqrt(model.width**2 + voxel**2 / 12)
    s3 = torch.sqrt(seen[:, 2])
    share = torch.exp(-model.offsets**2 / seen[:, 2]) / (math.sqrt(math.pi) * s3) / (2 * math.sqrt(math.pi) * w)
    plane = (energy * (jumps + floor) * share)[:, None]
    turning = plane * 0.5 * torch.stack([seen[:, 1], seen[:, 0], torch.zeros_like(s3)], 1)
    return torch.cat([total * plain[:, :6], total * plain[:, 6:9] + turning, plane + 1e-4 * total * 0.5 / seen[:, 2:]], 1)
