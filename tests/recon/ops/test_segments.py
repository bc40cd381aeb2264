"""Line integrals along segments: against closed forms, and against rays of the voxel projector."""

import numpy as np
import pytest

from phantomgen.geometry.voxel_grid import Grid
from recon.ops.segments import segment_integrals

GRID = Grid((9, 11, 13), (1.5, 2.0, 1.0), (-6.0, -10.0, -6.0))


def coordinates() -> list[np.ndarray]:
    return list(np.meshgrid(*(GRID.axis(name) for name in "zyx"), indexing="ij"))


def test_linear_volumes_have_the_integral_of_a_linear_function():
    z, y, x = coordinates()
    volumes = np.stack([2 + 0.1 * x - 0.05 * y + 0.2 * z, np.ones_like(x)])
    rng = np.random.default_rng(0)
    starts, ends = (rng.uniform(-0.9, 0.9, (50, 3)) * [6, 10, 6] for _ in range(2))
    lengths, middle = np.linalg.norm(ends - starts, axis=1), (starts + ends) / 2
    found = segment_integrals(starts, ends, volumes, GRID)
    assert found[:, 0] == pytest.approx(lengths * (2 + middle @ [0.1, -0.05, 0.2]), rel=1e-9)
    assert found[:, 1] == pytest.approx(lengths, rel=1e-9)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_ray_along_an_axis_gets_the_sum_of_its_voxels(axis):
    volumes = np.random.default_rng(1).uniform(size=(2, *GRID.shape))
    z, y, x = 4, 5, 6
    line = [volumes[:, z, y, :], volumes[:, z, :, x], volumes[:, :, y, x]][axis]
    start = np.array([[GRID.axis("x")[x], GRID.axis("y")[y], GRID.axis("z")[z]]])
    end = start.copy()
    start[0, axis], end[0, axis] = -100.0, 100.0
    spacing = GRID.spacing["zyx".index("xyz"[axis])]
    # a step of half a voxel cuts the tents of all voxels at their corners or in their middle: within 2 %
    assert segment_integrals(start, end, volumes, GRID)[0] == pytest.approx(line.sum(axis=1) * spacing, rel=0.02)


def test_a_smooth_ball_has_its_closed_form():
    z, y, x = coordinates()
    sigma, rng = 2.5, np.random.default_rng(2)
    volumes = np.exp(-(x**2 + y**2 + z**2) / (2 * sigma**2))[None]
    direction = rng.normal(size=(40, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    aside = np.cross(direction, rng.normal(size=(40, 3))) * 0.5
    found = segment_integrals(aside - 60 * direction, aside + 60 * direction, volumes, GRID)[:, 0]
    exact = sigma * np.sqrt(2 * np.pi) * np.exp(-(aside**2).sum(axis=1) / (2 * sigma**2))
    assert found == pytest.approx(exact, rel=0.1)  # voxels of 1.5 x 2 x 1 mm are coarse for it


def test_segments_beside_the_grid_and_of_no_length_get_nothing():
    volumes = np.ones((1, *GRID.shape))
    starts = np.array([[50.0, 0, 0], [0, 0, 0], [-50, 30, 0]])
    ends = np.array([[50.0, 9, 9], [0, 0, 0], [50, 30, 0]])
    assert not segment_integrals(starts, ends, volumes, GRID).any()
