"""The loop of both networks: Adam on the squared residual of a few rays per step, and volumes that are read off."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.published_methods.neural.networks import SEGMENT, Field
from recon.published_methods.neural.rays import Rays
from recon.voxel.method import Images, Iteration, OnIteration, Volumes

BRIGHTEST = 0.999  # quantile of the images that sets the unit of attenuation
VOXELS_AT_ONCE = 2**16
LAST_RATE = 0.1  # learning rate at the end over that at the start


@dataclass(frozen=True)
class Schedule:
    """How long and how finely a network is trained.

    Parameters
    ----------
    steps : of Adam
    rays : per step, about
    points : per ray
    rate : first learning rate of the features; it falls to a tenth
    network_rate : that of the network
    report_every : steps between two reports
    """

    steps: int
    rays: int
    points: int
    rate: float
    network_rate: float
    report_every: int


def attenuation_units(images: Images, grid: Grid) -> Float[Tensor, " channel"]:
    """Attenuation of each channel that counts as 1: a bright ray's over half of the longest edge [1/mm]."""
    bright = np.quantile(np.maximum(images, 0).reshape(len(images), -1), BRIGHTEST, axis=1)
    edge = max(n * spacing for n, spacing in zip(grid.shape, grid.spacing, strict=True))
    units = np.where(bright > 0, bright, 1.0) / (edge / 2)
    return torch.from_numpy(units).float()


def train(
    field: Field,
    rays: Rays,
    choose: Callable[[int], Int[np.ndarray, " ray"]],
    grid: Grid,
    schedule: Schedule,
    on_iteration: OnIteration,
) -> Volumes:
    """Fit a field to rays; returns its volumes [1/mm].

    Parameters
    ----------
    field : first weights; they are changed
    rays : what was measured
    choose : picks about so many rays
    grid : where to read the field
    schedule : numbers
    on_iteration : told every few steps, with the residual ||b - A x|| / ||b|| of the rays in between
    """
    groups = [
        {"params": field.encoding.parameters(), "lr": schedule.rate},
        {"params": field.network.parameters(), "lr": schedule.network_rate},
    ]
    adam = torch.optim.Adam(groups, betas=(0.9, 0.99), eps=1e-15)
    fall = torch.optim.lr_scheduler.ExponentialLR(adam, LAST_RATE ** (1 / schedule.steps))
    edge = max(n * spacing for n, spacing in zip(grid.shape, grid.spacing, strict=True))
    bright = field.units * (edge / 2)
    left, whole = 0.0, 0.0
    for step in range(1, schedule.steps + 1):
        numbers = choose(schedule.rays)
        measured, points = rays.measured(numbers), rays.points(numbers, schedule.points)
        predicted = field(points.places).sum(dim=1) * points.steps
        loss = ((predicted - measured) / bright).square().mean()
        adam.zero_grad()
        loss.backward()
        adam.step()
        fall.step()
        left += float((predicted.detach() - measured).square().sum())
        whole += float(measured.square().sum())
        if step % schedule.report_every == 0 and step < schedule.steps:
            residual = (left / whole) ** 0.5 if whole > 0 else 0.0
            on_iteration(Iteration(step, schedule.steps, residual, read(field, grid)))
            left, whole = 0.0, 0.0
    volumes = read(field, grid)
    on_iteration(Iteration(schedule.steps, schedule.steps, (left / whole) ** 0.5 if whole > 0 else 0.0, volumes))
    return volumes


@torch.no_grad()
def read(field: Field, grid: Grid) -> Volumes:
    """Attenuation at voxel centres [1/mm]; rows of voxels along x are the lines of a network that looks along lines.

    Rows are continued by a few points past the last voxel where the segments of such a network need it.
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
