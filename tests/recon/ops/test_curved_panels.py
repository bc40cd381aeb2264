"""Operators on curved panels: Gaussians against their closed form on a cylinder, projectors and their transposes."""

import numpy as np
import pytest
import torch

from phantomgen.geometry.curved_panel import module_frames, ray_directions
from phantomgen.geometry.panel import Curvature, Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.project import project, project_transpose
from recon.data.coverage import border_distances
from recon.gaussians.divided.model import DividedGaussians
from recon.ops.rasterize import Projector, rasterize

SOD, SDD, ROWS, COLUMNS, PITCH = 300.0, 600.0, 5, 24, 10.0
ANGLES = np.array([0.2, 1.7, 4.0])


def scanner(modules, radius=SDD):
    return Geometry.circular(SOD, SDD, ANGLES, Panel(ROWS, COLUMNS, PITCH, Curvature(radius, modules)))


def gaussians(count=40, seed=1):
    rng = np.random.default_rng(seed)
    quaternions = rng.normal(size=(count, 4))
    return (
        torch.from_numpy(rng.uniform(-40, 40, (count, 3))),
        torch.from_numpy(np.log(rng.uniform(6, 20, (count, 3)))),
        torch.from_numpy(quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)),
        torch.from_numpy(rng.uniform(0.001, 0.02, (count, 2))),
    )


def turned(q):
    w, x, y, z = q.T
    return np.moveaxis(
        np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        ),
        -1,
        0,
    )


def exact(parts, radius):
    """Line integrals along rays to the points of a cylinder, one by one in float64."""
    centres, log_scales, quaternions, coefficients = (part.numpy() for part in parts)
    whiten = np.exp(-log_scales)[:, :, None] * turned(quaternions).transpose(0, 2, 1)
    turn = (np.arange(COLUMNS) - (COLUMNS - 1) / 2) * PITCH / radius
    found = np.zeros((len(ANGLES), 2, ROWS, COLUMNS))
    for view, angle in enumerate(ANGLES):
        outward, tangent = np.array([np.cos(angle), np.sin(angle), 0]), np.array([-np.sin(angle), np.cos(angle), 0])
        for row, column in np.ndindex(ROWS, COLUMNS):
            pixel = (SOD - SDD + radius) * outward + radius * (
                np.sin(turn[column]) * tangent - np.cos(turn[column]) * outward
            )
            pixel[2] = ((ROWS - 1) / 2 - row) * PITCH
            source = SOD * outward
            direction = (pixel - source) / np.linalg.norm(pixel - source)
            u, v = np.einsum("gij,gj->gi", whiten, centres - source), np.einsum("gij,j->gi", whiten, direction)
            length = np.linalg.norm(v, axis=1)
            miss = np.linalg.norm(np.cross(u, v), axis=1) / length
            found[view, :, row, column] = (np.sqrt(2 * np.pi) / length * np.exp(-(miss**2) / 2)) @ coefficients
    return found


@pytest.mark.parametrize("radius", [SDD, 400.0])
def test_gaussians_have_the_line_integrals_of_the_closed_form(radius):
    parts = gaussians()
    frames = torch.from_numpy(module_frames(scanner(COLUMNS, radius)))
    found = rasterize(*parts, frames, ROWS, COLUMNS, Projector(footprint=0, cutoff=5))
    assert found.numpy() == pytest.approx(exact(parts, radius), abs=1e-5)


def test_gradients_pass_through_the_modules():
    parts = tuple(part.clone().requires_grad_() for part in gaussians(6))
    frames, flat = torch.from_numpy(module_frames(scanner(3))), module_frames(scanner(3)).reshape(-1, 4, 3)
    rasterize(*parts, frames, ROWS, COLUMNS).square().sum().backward()
    whole = [part.grad.clone() for part in parts]
    again = tuple(part.detach().clone().requires_grad_() for part in parts)
    rasterize(*again, torch.from_numpy(flat), ROWS, COLUMNS // 3).square().sum().backward()
    for one, other in zip(whole, again, strict=True):
        assert one.numpy() == pytest.approx(other.grad.numpy(), rel=1e-6)


def test_divided_gaussians_see_curved_panels_as_gaussians_do():
    parts = gaussians(8)
    plain = rasterize(*(p.float() for p in parts), torch.from_numpy(module_frames(scanner(4))), ROWS, COLUMNS)
    centres, log_scales, quaternions, coefficients = (p.float() for p in parts)
    both = torch.stack([coefficients, coefficients], dim=1)
    model = DividedGaussians(centres, log_scales, quaternions, torch.zeros(8), both, ("a", "b"), width=0.5)
    with torch.no_grad():
        found = model.line_integrals(scanner(4))
    assert found.numpy() == pytest.approx(plain.numpy(), abs=1e-3)  # they end at other distances


@pytest.mark.parametrize("modules", [1, 4, 24])
def test_a_homogeneous_box_has_the_lengths_of_the_rays_in_it(modules):
    grid = Grid.cube(40, 80.0)
    geometry = scanner(modules)
    found = project(np.ones((1, *grid.shape), np.float32), grid, module_frames(geometry), ROWS, COLUMNS)[0]
    columns, rows = np.arange(COLUMNS, dtype=float), np.arange(ROWS, dtype=float)
    rays = ray_directions(geometry, columns, rows)
    with np.errstate(divide="ignore"):
        ends = (np.array([[-40.0], [40.0]])[:, None, None, None] - geometry.source[:, None, None]) / rays
    enter, leave = np.sort(ends, axis=0).max(axis=-1)[0], np.sort(ends, axis=0).min(axis=-1)[1]
    lengths = np.maximum(leave - enter, 0) * np.linalg.norm(rays, axis=-1)
    inside = lengths > 40
    assert inside.sum() > 50
    errors = np.abs(found[inside] / lengths[inside] - 1)
    assert np.quantile(errors, 0.9) < 0.01  # but at corners of the box, where pixels are wide


def test_the_transpose_belongs_to_the_projector():
    rng, grid, frames = np.random.default_rng(4), Grid.cube(12, 80.0), module_frames(scanner(4))
    volume = rng.normal(size=(2, *grid.shape)).astype(np.float32)
    images = rng.normal(size=(2, 3, ROWS, COLUMNS)).astype(np.float32)
    there = (project(volume, grid, frames, ROWS, COLUMNS).astype(float) * images).sum()
    back = (project_transpose(images, grid, frames).astype(float) * volume).sum()
    assert there == pytest.approx(back, rel=1e-5)


def test_tensors_give_what_arrays_give():
    grid, frames = Grid.cube(12, 80.0), module_frames(scanner(4))
    volume = np.random.default_rng(4).normal(size=(2, *grid.shape)).astype(np.float32)
    images = project(torch.from_numpy(volume), grid, torch.from_numpy(frames), ROWS, COLUMNS)
    assert images.numpy() == pytest.approx(project(volume, grid, frames, ROWS, COLUMNS), abs=1e-4)


def test_borders_are_those_of_the_arc():
    found = border_distances(scanner(24))
    half = COLUMNS / 2 * PITCH / SDD  # angle to the outer edge of the last column
    assert found == pytest.approx(np.full((3, 2), SOD * np.sin(half)), rel=1e-3)
