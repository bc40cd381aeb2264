"""Placement of divided Gaussians on surfaces, their steps, and their fit to volumes."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.divided.fit_to_volume import fit_divided_to_volume, solve_coefficients
from recon.gaussians.divided.model import DividedGaussians
from recon.gaussians.divided.placement import place_on_surfaces
from recon.gaussians.divided.steps import GEOMETRY, gradient_of_steps, moved
from recon.gaussians.divided.surfaces import surfaces_of
from recon.gaussians.initial.first_guess import OccupiedPart, in_air
from recon.gaussians.settings import SurfaceSettings

SIDE = 32
GRID = Grid.cube(SIDE, float(SIDE))
SETTINGS = SurfaceSettings()
METRIC = np.eye(1)


def ball(radius: float = 10.0, centre: tuple[float, float, float] = (0.3, -0.2, 0.1)) -> np.ndarray:
    """Means over voxels of a ball of value 1, of 6^3 points each, (1, Z, Y, X)."""
    at = (np.arange(SIDE * 6) + 0.5) / 6 - SIDE / 2
    z, y, x = np.meshgrid(at, at, at, indexing="ij", sparse=True)
    inside = (x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2 < radius**2
    return inside.reshape(SIDE, 6, SIDE, 6, SIDE, 6).mean(axis=(1, 3, 5))[None].astype(np.float32)


def box(half: int = 8) -> np.ndarray:
    out = np.zeros((1, SIDE, SIDE, SIDE), np.float32)
    inner = slice(SIDE // 2 - half, SIDE // 2 + half)
    out[0, inner, inner, inner] = 1
    return out


def placed(volumes: np.ndarray, grid: Grid = GRID, settings: SurfaceSettings = SETTINGS) -> DividedGaussians:
    return place_on_surfaces(volumes, grid, METRIC, ("compton",), 0, settings)


@pytest.mark.parametrize("radius", [6.0, 10.0])
def test_points_lie_on_a_sphere_with_its_normals(radius):
    found = surfaces_of(ball(radius), np.ones(1), SETTINGS)
    away = found.points - (SIDE - 1) / 2 - np.array([0.3, -0.2, 0.1])
    distance = np.linalg.norm(away, axis=1)
    assert len(found.points) > 4 * math.pi * radius**2 / 2
    assert np.sqrt(np.mean((distance - radius) ** 2)) < 0.05 + 1 / radius  # smoothing moves a curved surface inward
    outward = (found.normals * away).sum(axis=1) / distance
    assert np.quantile(outward, 0.9) < -0.95  # attenuation grows inward


def test_planes_reach_further_on_flatter_surfaces():
    on_small, on_large = (surfaces_of(ball(r), np.ones(1), SETTINGS).radii for r in (5.0, 12.0))
    faces = surfaces_of(box(12), np.ones(1), SETTINGS)
    middle = (np.abs(faces.points - (SIDE - 1) / 2) < 2).sum(axis=1) == 2
    assert np.median(on_small) < np.median(on_large) < np.median(faces.radii[middle])


def test_volumes_without_a_surface_have_no_points():
    assert len(surfaces_of(np.ones((1, 8, 8, 8), np.float32), np.ones(1), SETTINGS).points) == 0
    model = place_on_surfaces(np.ones((1, 8, 8, 8), np.float32), Grid.cube(8, 8.0), METRIC, ("compton",), 0, SETTINGS)
    assert len(model) > 0
    assert not model.divided.any()


def test_smaller_distances_place_more_gaussians():
    few, many = (placed(ball(), settings=replace(SETTINGS, spacing=s, finest=s)) for s in (1.6, 0.8))
    assert len(many) > 1.5 * len(few)


@pytest.mark.parametrize("count", [60, 300, 1000])
def test_about_as_many_gaussians_are_placed_as_are_wanted(count):
    assert len(placed(ball(), settings=replace(SETTINGS, count=count))) == pytest.approx(count, rel=0.02, abs=5)


def test_no_more_gaussians_are_placed_than_there_are_voxels():
    assert 1000 < len(placed(ball(), settings=replace(SETTINGS, count=10**7))) < 2 * ball().size


def test_the_same_object_elsewhere_gets_the_same_gaussians():
    volume = ball(7.0)
    shifted = Grid(GRID.shape, GRID.spacing, tuple(o + 4 for o in GRID.origin))  # type: ignore[arg-type]
    rolled = np.roll(volume, (-4, -4, -4), axis=(1, 2, 3))
    one, other = placed(volume), placed(rolled, shifted)
    assert len(one) == len(other)
    torch.testing.assert_close(one.centres, other.centres, atol=1e-4, rtol=0)


def test_gradients_of_steps_are_those_of_differences():
    model = placed(ball(6.0))
    model = model.part(torch.arange(0, len(model), 9))
    model = replace(model, width=0.4)
    weights = torch.from_numpy(np.random.default_rng(0).normal(size=(1, *GRID.shape))).float()
    parts = {name: value.detach().requires_grad_() for name, value in model.tensors().items()}
    (model.with_tensors(parts).voxels(GRID) * weights).sum().backward()
    found = gradient_of_steps(model, [part.grad for part in parts.values()])
    for column in range(GEOMETRY + 2):
        step = torch.zeros_like(found)
        step[:, column] = 0.02 * model.coefficients.mean() if column >= GEOMETRY else 0.02
        with torch.no_grad():
            ahead, behind = (float((moved(model, s * step).voxels(GRID).double() * weights).sum()) for s in (1, -1))
        wanted = (ahead - behind) / 2
        assert float((found * step).sum()) == pytest.approx(wanted, rel=0.05, abs=2e-3), column


def test_conjugate_gradients_lower_the_distance_in_the_coefficients_alone():
    start = placed(ball())
    solved = solve_coefficients(start, ball(), GRID, METRIC, 8)
    before, after = (float(((m.voxels(GRID).numpy() - ball()) ** 2).sum()) for m in (start, solved))
    assert after < 0.3 * before
    assert torch.equal(solved.centres, start.centres)


def test_a_ball_is_fitted_and_stays_sharp_between_voxels():
    volume = ball()
    start = solve_coefficients(placed(volume), volume, GRID, METRIC, 8)
    fitted = fit_divided_to_volume(start, volume, GRID, METRIC, 60)
    error = np.mean((fitted.volume(GRID) - volume) ** 2)
    assert -10 * math.log10(error) > 42
    finer = Grid.cube(2 * SIDE, float(SIDE))
    at = (np.arange(4 * SIDE) + 0.5) / 4 - SIDE / 2
    z, y, x = np.meshgrid(at, at, at, indexing="ij", sparse=True)
    inside = (x - 0.3) ** 2 + (y + 0.2) ** 2 + (z - 0.1) ** 2 < 100
    truth = inside.reshape(2 * SIDE, 2, 2 * SIDE, 2, 2 * SIDE, 2).mean(axis=(1, 3, 5))
    between = np.mean((fitted.volume(finer)[0] - truth) ** 2)
    repeated = np.mean((volume[0].repeat(2, 0).repeat(2, 1).repeat(2, 2) - truth) ** 2)
    assert between < 0.3 * repeated  # than the true voxels, which know nothing between


def test_no_dense_sheet_forms_at_a_face_of_a_box():
    volume = box()
    start = solve_coefficients(placed(volume), volume, GRID, METRIC, 8)
    fitted = fit_divided_to_volume(start, volume, GRID, METRIC, 60)
    thirds = Grid.cube(3 * SIDE, float(SIDE))
    middle = slice(3 * SIDE // 2 - 3, 3 * SIDE // 2 + 3)
    profile = fitted.volume(thirds)[0][:, middle, middle].mean(axis=(1, 2))
    assert profile.max() < 1.1


def test_faces_at_the_border_of_the_volumes_are_surfaces_once_air_is_around():
    volume, grid = np.ones((1, 12, 12, 12), np.float32), Grid.cube(12, 12.0)
    part = in_air(OccupiedPart(volume, grid), SETTINGS.air)
    assert part.grid.axis("x")[SETTINGS.air : -SETTINGS.air] == pytest.approx(grid.axis("x"))
    model = place_on_surfaces(*part, METRIC, ("compton",), 0, SETTINGS)
    bare = place_on_surfaces(volume, grid, METRIC, ("compton",), 0, SETTINGS)
    assert int(model.divided.sum()) > len(model) / 2 > int(bare.divided.sum())
    model = fit_divided_to_volume(solve_coefficients(model, *part, METRIC, 8), *part, METRIC, 40)
    beyond = model.voxels(Grid.cube(28, 28.0)).numpy()
    beyond[:, 8:20, 8:20, 8:20] = 0
    assert np.abs(beyond).mean() < 4e-3


def test_an_object_of_few_voxels_in_much_air_gets_gaussians_of_its_size():
    volume = np.zeros((1, 40, 40, 40), np.float32)
    volume[0, 18:21, 18:21, 5:35] = 0.02  # a rod of 0.4 % of the voxels
    grid = Grid.cube(40, 40.0)
    model = place_on_surfaces(volume, grid, METRIC, ("compton",), 0, SETTINGS)
    assert 10 < len(model) < 200
    fitted = fit_divided_to_volume(solve_coefficients(model, volume, grid, METRIC, 8), volume, grid, METRIC, 40)
    assert np.sqrt(np.mean((fitted.volume(grid) - volume) ** 2)) < 1e-4
