"""The prior that holds a fit near volumes: its gradients, its curvature, and what it does to noise."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from gaussian_scenes import small_model

from phantomgen.grid import Grid
from recon.anchor import SLABS, Anchor
from recon.fit_state import GEOMETRY

GRID = Grid((10, 9, 8), (2.0, 2.0, 2.0), (-9.0, -8.0, -7.0))
PARTS = (*GEOMETRY, "coefficients")
WEIGHT = torch.tensor([[2.0, 0.3, 0.1], [0.3, 1.0, 0.2], [0.1, 0.2, 3.0]])


def model(seed):
    return small_model(seed, count=12)


def anchor(strength=0.3):
    return Anchor(model(1).volume(GRID), GRID, strength)


def cost(gaussians, held):
    """Half the weighted squared distance, in float64."""
    away = gaussians.volume(GRID).astype(float) - held.volumes
    return 0.5 * np.einsum("mzyx,mn,nzyx->", away, WEIGHT.double().numpy(), away)


def gradients(gaussians, held):
    """Mean of the gradients of all slabs."""
    found = gaussians.detached()
    for name in PARTS:
        tensor = getattr(found, name).requires_grad_()
        tensor.grad = torch.zeros_like(tensor)
    for step in range(SLABS):
        held.add_gradients(found, WEIGHT / SLABS, step)
    return {name: getattr(found, name).grad for name in PARTS}


@pytest.mark.parametrize("name", PARTS)
def test_slabs_in_turn_give_the_gradient_of_the_whole_distance(name):
    held, start = anchor(), model(2)
    pull = gradients(start, held)[name].double()
    direction = pull / abs(pull).max()  # along itself, where the slope is steepest
    size = 1e-2 * getattr(start, name).abs().mean()
    ends = (replace(start, **{name: getattr(start, name) + (s * size * direction).float()}) for s in (1, -1))
    slope = (cost(next(ends), held) - cost(next(ends), held)) / (2 * float(size))
    assert slope == pytest.approx(float((pull * direction).sum()), rel=2e-2)


def test_the_curvature_is_a_majoriser_of_the_distance_in_the_coefficients():
    held, start = anchor(), model(2)
    blocks = torch.eye(3).repeat(len(start), 1, 1)
    both, weight = held.curvature(start, blocks)
    assert weight == pytest.approx(
        0.3 * blocks.sum(dim=0).numpy() / float((both - blocks)[:, 0, 0].sum() / weight[0, 0])
    )
    rng = np.random.default_rng(4)
    for _ in range(5):
        step = torch.from_numpy(rng.normal(size=start.coefficients.shape)).float()
        moved = replace(start, coefficients=step).volume(GRID).astype(float)
        bend = np.einsum("mzyx,mn,nzyx->", moved, weight.double().numpy(), moved)
        assert bend <= float(torch.einsum("gm,gmn,gn->", step, both - blocks, step)) * (1 + 1e-5)


def test_a_model_at_its_anchor_is_not_pulled():
    held = anchor()
    assert all(abs(pull).max() < 1e-6 for pull in gradients(model(1), held).values())
