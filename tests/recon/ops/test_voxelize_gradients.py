import numpy as np
import pytest
import torch
from support.gaussian_scenes import REGIMES, one_gaussian, random_gaussians
from support.tolerances import TOLERANCES

from phantomgen.geometry.voxel_grid import Grid
from recon.ops.voxelize import reference, voxelize, voxelize_tensor
from spectra.threads import set_threads

OBLONG = Grid((11, 14, 9), (1.0, 1.2, 0.9), (-5.3, -8.0, -4.0))
TINY = Grid((2, 3, 4), (1.3, 1.0, 0.8), (-0.9, -1.1, -1.0))


def axes_of(grid):
    return tuple(torch.from_numpy(grid.axis(name)) for name in "zyx")


def value_and_gradients(function, parts, seed=0):
    leaves = [part.clone().requires_grad_() for part in parts]
    value = function(*leaves)
    cotangent = torch.from_numpy(np.random.default_rng(seed).normal(size=value.shape)).to(value)
    return value.detach(), torch.autograd.grad(value, leaves, cotangent)


def rms_error(value, truth):
    return float(((value - truth).square().mean() / truth.square().mean()).sqrt())


@pytest.mark.parametrize("bases", [1, 3])
@pytest.mark.parametrize("regime", REGIMES)
def test_gradients_are_those_of_the_reference(regime, bases):
    parts = random_gaussians(1, bases=bases, sigma=REGIMES[regime], spread=4.0)
    _, truth = value_and_gradients(lambda *p: reference.voxelize(*p, axes_of(OBLONG), OBLONG.spacing), parts)
    _, found = value_and_gradients(lambda *p: voxelize_tensor(*p, OBLONG, cutoff=5.0), parts)
    for gradient, expected in zip(found, truth, strict=True):
        assert rms_error(gradient, expected) < TOLERANCES["kernel_gradient"]


def test_gradients_of_the_reference_are_finite_differences():
    parts = [p.requires_grad_() for p in random_gaussians(2, count=2, bases=2, sigma=(0.3, 1.5), spread=1.0)]
    assert torch.autograd.gradcheck(lambda *p: reference.voxelize(*p, axes_of(TINY), TINY.spacing), parts)


def test_without_footprint_gradients_are_finite_differences_of_the_density():
    """Voxel centres sample the density itself; steps of 1e-3 in float32 values need a wide tolerance."""
    parts = random_gaussians(3, count=3, bases=1, sigma=(1.0, 2.0), spread=2.0)
    cotangent = torch.from_numpy(np.random.default_rng(4).normal(size=(1, *OBLONG.shape)))

    def loss(*p):
        return float((voxelize_tensor(*p, OBLONG, footprint=0.0, cutoff=5.0).double() * cotangent).sum())

    leaves = [p.clone().requires_grad_() for p in parts]
    (voxelize_tensor(*leaves, OBLONG, footprint=0.0, cutoff=5.0) * cotangent).sum().backward()
    for i, leaf in enumerate(leaves):
        scale = float(leaf.grad.abs().max())
        for place in np.ndindex(*leaf.shape):
            ends = []
            for step in (-1e-3, 1e-3):
                moved = [p.clone() for p in parts]
                moved[i][place] += step
                ends.append(loss(*moved))
            assert leaf.grad[place].item() == pytest.approx((ends[1] - ends[0]) / 2e-3, abs=5e-3 * scale)


@pytest.mark.parametrize("regime", REGIMES)
def test_volume_and_gradient_in_the_coefficients_are_adjoint(regime):
    """<V b, u> = <b, V^T u> for the linear map V from coefficients to voxels."""
    *shape, values = random_gaussians(5, sigma=REGIMES[regime], spread=4.0)
    values = values.clone().requires_grad_()
    volume = voxelize_tensor(*shape, values, OBLONG)
    other = torch.from_numpy(np.random.default_rng(6).uniform(size=volume.shape))
    (back,) = torch.autograd.grad(volume, values, other)
    forward, backward = float((volume.detach() * other).sum()), float((values.detach() * back).sum())
    assert forward == pytest.approx(backward, rel=1e-5)


def test_gradients_of_parts_of_a_grid_add_up_to_those_of_the_whole():
    parts = random_gaussians(7, sigma=REGIMES["needle"], spread=4.0)
    cotangent = torch.from_numpy(np.random.default_rng(8).normal(size=(3, *OBLONG.shape)))
    leaves = [p.clone().requires_grad_() for p in parts]
    whole = torch.autograd.grad(voxelize_tensor(*leaves, OBLONG), leaves, cotangent)
    sums = [torch.zeros_like(p) for p in parts]
    for first, count in ((0, 3), (3, 1), (4, 7)):
        some = voxelize_tensor(*leaves, OBLONG.slices(first, count))
        parts_of_it = torch.autograd.grad(some, leaves, cotangent[:, first : first + count])
        sums = [total + part for total, part in zip(sums, parts_of_it, strict=True)]
    for total, expected in zip(sums, whole, strict=True):
        assert rms_error(total, expected) < 1e-5


@pytest.mark.parametrize("sigma", [(0.02,) * 3, (0.05, 0.05, 1.0)])
def test_the_mass_of_a_narrow_gaussian_does_not_change_with_its_place(sigma):
    """The gradient of the sum over all voxels: none in the centre, the sum itself in each log-scale.

    What is left are lattice harmonics beyond the nearest, as in the mass itself, times their wave number.
    """
    grid = Grid.cube(15, 15.0)
    parts = [p.requires_grad_() for p in one_gaussian([0.2, -0.3, 0.4], sigma)]
    mass = voxelize_tensor(*parts, grid).sum()
    centre, log_scales, _, value = torch.autograd.grad(mass, parts)
    peak = float(mass.detach())
    assert value.item() == pytest.approx(peak, rel=1e-5)
    assert centre.abs().max() < 4 * np.pi * TOLERANCES["narrow_voxel_mass"] * peak
    torch.testing.assert_close(log_scales, torch.full((1, 3), peak).to(log_scales), rtol=0.15, atol=0)


def test_any_number_of_threads_gives_the_same_bits(monkeypatch):
    monkeypatch.setattr("recon.ops.voxelize.cpu_calls.CHUNK", 7)
    parts, results = [p.float() for p in random_gaussians(9, count=40)], []
    try:
        for threads in (1, 2, 3):
            set_threads(threads)
            value, gradients = value_and_gradients(lambda *p: voxelize_tensor(*p, OBLONG), parts)
            results.append([value, *gradients])
    finally:
        set_threads(None)
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


def test_the_tensor_holds_the_bits_of_the_array():
    parts = [p.float() for p in random_gaussians(10)]
    np.testing.assert_array_equal(voxelize_tensor(*parts, OBLONG).numpy(), voxelize(*parts, OBLONG))


def test_a_gaussian_outside_the_grid_has_no_gradient():
    parts = [p.requires_grad_() for p in one_gaussian([1e4, 0.0, 0.0], 1.0)]
    assert not any(g.any() for g in torch.autograd.grad(voxelize_tensor(*parts, OBLONG).sum(), parts))
