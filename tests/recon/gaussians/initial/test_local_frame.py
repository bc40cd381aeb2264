"""Steps in the frames of Gaussians: their gradient is that of the function they change."""

from dataclasses import replace

import pytest
import torch
from support.gaussian_scenes import NAMES, one_gaussian, random_gaussians

from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.initial.local_frame import GEOMETRY, gradient_of_steps, moved
from recon.gaussians.model import Gaussians
from recon.ops.voxelize.reference import voxelize

GRID = Grid((7, 8, 9), (1.0, 1.0, 1.0), (-3.0, -3.5, -4.0))
AXES = tuple(torch.from_numpy(GRID.axis(name)) for name in "zyx")


def model(seed=3):
    return Gaussians(*random_gaussians(seed, count=5, spread=2.0), NAMES)


def test_no_step_changes_nothing_but_the_length_of_quaternions():
    start = model()
    same = moved(start, torch.zeros(len(start), GEOMETRY + 3, dtype=torch.float64))
    for name in ("centres", "log_scales", "coefficients"):
        torch.testing.assert_close(getattr(same, name), getattr(start, name))
    torch.testing.assert_close(same.quaternions, torch.nn.functional.normalize(start.quaternions))


@pytest.mark.parametrize("kind", ["move", "scale", "turn", "coefficient"])
def test_gradients_are_those_of_finite_steps(kind):
    start = model()
    weights = torch.rand(3, *GRID.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)

    def cost(gaussians):
        parts = (gaussians.centres, gaussians.log_scales, gaussians.quaternions, gaussians.coefficients)
        return (weights * voxelize(*parts, AXES, GRID.spacing)).sum()

    leaves = {name: getattr(start, name).clone().requires_grad_() for name in start.__dict__ if name != "basis_names"}
    cost(replace(start, **leaves)).backward()
    gradient = gradient_of_steps(start, [leaf.grad for leaf in leaves.values()])
    columns = {"move": [0, 1, 2], "scale": [3, 4, 5], "turn": [6, 7, 8], "coefficient": [9, 10, 11]}[kind]
    for column in columns:
        step = torch.zeros_like(gradient)
        step[:, column] = 1e-5 * torch.linspace(-1, 1, len(start), dtype=torch.float64)
        slope = (cost(moved(start, step)) - cost(moved(start, -step))) / 2
        assert float(slope) == pytest.approx(float((gradient * step).sum()), rel=1e-6, abs=1e-12)


def test_moves_go_along_the_axes_of_the_gaussian():
    centres, scales, _, coefficients = one_gaussian((0.0, 0.0, 0.0), (1.0, 2.0, 3.0))
    quarter = torch.tensor([[0.5**0.5, 0.0, 0.0, 0.5**0.5]], dtype=torch.float64)  # about z: x becomes y
    steps = torch.zeros(1, GEOMETRY + 1, dtype=torch.float64)
    steps[0, 0] = 0.7
    after = moved(Gaussians(centres, scales, quarter, coefficients, ("one",)), steps)
    torch.testing.assert_close(after.centres, torch.tensor([[0.0, 0.7, 0.0]], dtype=torch.float64))


def test_coefficients_end_at_zero():
    start = model()
    steps = torch.zeros(len(start), GEOMETRY + 3, dtype=torch.float64)
    steps[:, GEOMETRY:] = -10.0
    assert (moved(start, steps).coefficients == 0).all()
