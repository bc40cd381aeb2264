"""Chords of ellipsoids: kernels against float64, against closed forms, and on a grid."""

import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from support.gaussian_scenes import GEOMETRIES, PIXEL, REGIMES, circular, frames_of, one_gaussian, random_gaussians
from support.tolerances import TOLERANCES

from phantomgen.geometry.voxel_grid import Grid
from recon.ops.chords import SMOOTH, chords, fill, reference
from spectra.errors import InputError
from spectra.threads import set_threads


def value_and_gradients(function, parts):
    leaves = [part.clone().requires_grad_() for part in parts]
    value = function(*leaves)
    cotangent = torch.from_numpy(np.random.default_rng(0).normal(size=value.shape))
    return value.detach(), torch.autograd.grad(value, leaves, cotangent)


@pytest.mark.parametrize("smooth", [SMOOTH, 0.3])
@pytest.mark.parametrize("regime", ["typical", "wide", "needle"])
@pytest.mark.parametrize(("where", "bases"), [("odd-even", 3), ("even-odd", 1), ("tilted", 2)])
def test_kernel_gives_the_values_and_gradients_of_the_reference(where, bases, regime, smooth):
    geometry, parts = GEOMETRIES[where], random_gaussians(3, bases=bases, sigma=REGIMES[regime])
    view = (frames_of(geometry), geometry.panel.rows, geometry.panel.columns, smooth)
    truth, gradients = value_and_gradients(lambda *p: reference.chords(*p, *view), parts)
    image, kernel_gradients = value_and_gradients(lambda *p: chords(*p, *view), parts)
    assert float((image - truth).abs().max() / truth.abs().max()) < TOLERANCES["chord_value"]
    for gradient, expected in zip(kernel_gradients, gradients, strict=True):
        error = (gradient - expected).square().mean() / expected.square().mean()
        assert float(error.sqrt()) < TOLERANCES["chord_gradient"]


def test_gradients_of_the_reference_are_finite_differences():
    geometry = circular(4, 5, views=1)
    parts = [part.requires_grad_() for part in random_gaussians(1, count=2, bases=2, sigma=(3.0, 5.0), spread=1.0)]
    assert torch.autograd.gradcheck(lambda *p: reference.chords(*p, frames_of(geometry), 4, 5, 0.3), parts)


def test_chords_of_a_sphere_are_those_of_geometry():
    """2 sqrt(R^2 - b^2) with the distance b of the ray from the centre, where the root is not bent."""
    geometry, radius, centre = circular(), 4.0, np.array([1.0, -0.5, 0.3])
    panel = geometry.panel
    image = chords(*one_gaussian(tuple(centre), radius), frames_of(geometry), panel.rows, panel.columns).numpy()
    for (origin, first, column_step, row_step), shown in zip(geometry.ray_frames(), image, strict=True):
        rows, columns = np.mgrid[: panel.rows, : panel.columns][..., None]
        rays = first + columns * column_step + rows * row_step
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        distance = np.linalg.norm(np.cross(rays, centre - origin), axis=-1)
        exact = 2 * np.sqrt(np.maximum(radius**2 - distance**2, 0))
        straight = (1 - distance**2 / radius**2 > SMOOTH) | (distance > radius)
        np.testing.assert_allclose(shown[0][straight], exact[straight], atol=2 * radius * TOLERANCES["chord_value"])
        assert (shown[0] <= exact + 1e-5).all()


def test_the_smooth_root_meets_the_root_with_its_slope():
    t = torch.tensor([SMOOTH - 1e-9, SMOOTH + 1e-9], dtype=torch.float64, requires_grad=True)
    value = reference.root(t, SMOOTH)
    np.testing.assert_allclose(value.detach(), math.sqrt(SMOOTH), rtol=1e-7)
    np.testing.assert_allclose(torch.autograd.grad(value.sum(), t)[0], 0.5 / math.sqrt(SMOOTH), rtol=1e-6)


def test_an_ellipsoid_that_reaches_the_source_or_the_panel_is_left_out():
    geometry = circular(views=1)
    for centre in (geometry.source[0], geometry.panel_center[0]):
        image = chords(*one_gaussian(tuple(0.99 * centre), 2.0), frames_of(geometry), 13, 16)
        assert not image.any()


def test_threads_do_not_change_a_bit():
    geometry, parts = GEOMETRIES["tilted"], random_gaussians(5, count=3000)
    found = []
    for threads in (1, 2):
        set_threads(threads)
        value, gradients = value_and_gradients(lambda *p: chords(*p, frames_of(geometry), 14, 11), parts)
        volume = fill(*parts[:3], parts[3][:, 0], Grid.cube(16, 16.0))
        found.append([value.numpy(), *(gradient.numpy() for gradient in gradients), volume])
    set_threads(None)
    for one, two in zip(*found, strict=True):
        np.testing.assert_array_equal(one, two)


def test_ellipsoids_on_a_grid_keep_their_mass_and_add_up():
    grid, axes = Grid.cube(40, 20.0), np.array([3.0, 5.0, 2.0])
    turn = Rotation.from_euler("xyz", [0.3, 0.5, 0.7]).as_quat()[[3, 0, 1, 2]]
    centres = torch.tensor([[1.0, 0.5, -1.0]] * 2, dtype=torch.float64)
    parts = (centres, torch.from_numpy(np.log([axes] * 2)), torch.from_numpy(np.array([turn] * 2)))
    volume = fill(*parts, torch.tensor([0.3, 0.1]), grid, 4)
    assert volume.max() == pytest.approx(0.4)
    mass = volume.sum(dtype=float) * np.prod(grid.spacing)
    assert mass == pytest.approx(0.4 * 4 / 3 * np.pi * axes.prod(), rel=TOLERANCES["filled_mass"])
    centre = [(volume.sum((1, 2)), volume.sum((0, 2)), volume.sum((0, 1)))[i] @ grid.axis("zyx"[i]) for i in range(3)]
    np.testing.assert_allclose(np.array(centre) / volume.sum(), [-1.0, 0.5, 1.0], atol=0.02)


def test_parts_of_a_grid_hold_what_the_whole_holds():
    parts, grid = random_gaussians(2, count=20, sigma=(1.0, 4.0)), Grid.cube(16, 12.0)
    whole = fill(*parts[:3], parts[3][:, 0], grid)
    piece = Grid((5, 6, 7), grid.spacing, tuple(o + 4 * s for o, s in zip(grid.origin, grid.spacing, strict=True)))
    np.testing.assert_array_equal(fill(*parts[:3], parts[3][:, 0], piece), whole[4:9, 4:10, 4:11])


@pytest.mark.parametrize("smooth", [0.0, 1.0])
@pytest.mark.wrong_types
def test_what_cannot_be_is_one_sentence(smooth):
    parts = one_gaussian((0.0, 0.0, 0.0), PIXEL)
    with pytest.raises(InputError, match="smooth must be between 0 and 1"):
        chords(*parts, frames_of(circular()), 13, 16, smooth)
    with pytest.raises(InputError, match=r"chords: log_axes has shape \(1, 2\), expected \(1, 3\)"):
        chords(parts[0], parts[1][:, :2], *parts[2:], frames_of(circular()), 13, 16)
