"""Voxel maps among solids: path lengths, pixel averages and truth, against points, boxes, and the solids voxelized."""

import numpy as np
import pytest

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.expected_counts import VOXELS, Spectrum, expected_counts, expected_counts_by_grid
from phantomgen.ops.trace import trace
from phantomgen.ops.voxel_maps import VoxelMap
from phantomgen.ops.voxelize_shapes import fractions
from phantomgen.shapes import Box, Cylinder, HalfSpace, Intersection, Placed, Sphere, Voxels, rotation_matrix, solids_of
from spectra.errors import InputError

LABELS = np.random.default_rng(0).integers(0, 3, (5, 6, 7))
TURN = rotation_matrix((0.3, 0.4, 0.5))
TURNED = Voxels(VoxelMap.of_labels(LABELS, [1, 2]), TURN * np.array([3.5, 4.5, 3.0]), np.array([1.0, 2, 3]))
BELOW, ABOVE = Sphere((0, 0, 0), 3.0), Cylinder((1, 2, 3), 1.0, 20.0)
AMONG = [(BELOW, 0), (TURNED, (1, 2)), (ABOVE, 0)]
SPECTRUM = Spectrum(np.array([[0.02], [0.06], [0.03]]), np.array([1e5]), np.array([0, 1]))


def materials_at(points: np.ndarray) -> np.ndarray:
    """Mixture of each point in `AMONG`."""
    part = TURNED.terms[0][0]
    local = part.local[:, :3] @ points.T + part.local[:, 3:]
    found = np.zeros((len(points), 3))
    found[BELOW.contains(points), 0] = 1
    inside = (np.abs(local) < 1).all(axis=0)
    found[inside, 0] = 0
    found[:, 1:] += part.voxels.at(local)
    found[ABOVE.contains(points)] = [1, 0, 0]
    return found


def test_lengths_among_solids_are_those_of_points() -> None:
    starts, ends = np.random.default_rng(1).normal(size=(2, 60, 3)) * 8
    found = trace(starts, ends - starts, solids_of(AMONG), 3)
    t = (np.arange(20_000) + 0.5) / 20_000
    for length, start, end in zip(found, starts, ends, strict=True):
        points = start + t[:, None] * (end - start)
        expected = materials_at(points).mean(axis=0) * np.linalg.norm(end - start)
        np.testing.assert_allclose(length, expected, atol=0.01)
    total = trace(starts, ends - starts, solids_of(AMONG), 4, background=3).sum(axis=1)
    np.testing.assert_allclose(total, np.linalg.norm(ends - starts, axis=1), rtol=1e-12)


@pytest.mark.parametrize("way", [(1, 0, 0), (0, -1, 0), (1, 1, 0), (1, 1, 1), (-1, 2, 0)], ids=str)
@pytest.mark.parametrize("shift", [0.0, 0.5, 0.25], ids=["faces", "middles", "between"])
def test_rays_along_faces_edges_and_corners_belong_to_one_voxel(way: tuple, shift: float) -> None:
    """Full voxels of two materials are a box: every length is its chord, whatever face or corner a ray runs through."""
    labels = np.indices((4, 4, 4)).sum(axis=0) % 2 + 1
    voxels = solids_of([(Voxels(VoxelMap.of_labels(labels, [1, 2]), 2 * np.eye(3), np.zeros(3)), (0, 1))])
    box = solids_of([(Box((0, 0, 0), (4, 4, 4)), 0)])
    places = np.arange(-3, 3.5, 1.0) + shift
    starts = np.array(np.meshgrid(*[places] * 3)).reshape(3, -1).T - 10 * np.array(way)
    ways = np.tile(20.0 * np.array(way), (len(starts), 1))
    found = trace(starts, ways, voxels, 2).sum(axis=1)
    np.testing.assert_allclose(found, trace(starts, ways, box, 1)[:, 0], atol=1e-12)


def test_fractions_and_labels_are_the_same_map() -> None:
    parts = np.stack([LABELS == 1, LABELS == 2]).astype(float)
    starts, ends = np.random.default_rng(2).normal(size=(2, 50, 3)) * 4
    shapes = [
        Voxels(voxels, np.diag([3.5, 4.5, 3.0]), np.zeros(3))
        for voxels in (VoxelMap.of_labels(LABELS, [1, 2]), VoxelMap.of_fractions(parts))
    ]
    one, other = (trace(starts, ends - starts, solids_of([(shape, (0, 1))]), 2) for shape in shapes)
    np.testing.assert_allclose(one, other, rtol=1e-12)
    half = Voxels(VoxelMap.of_fractions(0.5 * parts), np.diag([3.5, 4.5, 3.0]), np.zeros(3))
    np.testing.assert_allclose(trace(starts, ends - starts, solids_of([(half, (0, 1))]), 2), one / 2, rtol=1e-12)


def test_maps_can_be_cut_moved_and_mirrored() -> None:
    starts, ends = np.random.default_rng(3).normal(size=(2, 50, 3)) * 6
    mirror, move = np.diag([-1.0, 2.0, 1.0]), np.array([1.0, 0, 2])
    moved = trace(
        starts @ mirror + move, (ends - starts) @ mirror, solids_of([(Placed(TURNED, mirror, move), (0, 1))]), 2
    )
    plain = trace(starts, ends - starts, solids_of([(TURNED, (0, 1))]), 2)
    stretch = np.linalg.norm((ends - starts) @ mirror, axis=1) / np.linalg.norm(ends - starts, axis=1)
    np.testing.assert_allclose(moved, plain * stretch[:, None], rtol=1e-9, atol=1e-12)
    halves = [Intersection((TURNED, HalfSpace(normal, 0.5 * sum(normal)))) for normal in ((1, 0, 0), (-1, 0, 0))]
    parts = [trace(starts, ends - starts, solids_of([(half, (0, 1))]), 2) for half in halves]
    np.testing.assert_allclose(sum(parts), plain, atol=1e-9)


def cylinder_map(voxels: int) -> VoxelMap:
    """A rod in a cylinder, as fractions in a cube of 100 mm."""
    found = fractions(Grid.cube(voxels, 100.0), CYLINDERS, 2)
    return VoxelMap.of_fractions(found.astype(np.float64).clip(0, 1))


CYLINDERS = solids_of([(Cylinder((0, 0, 0), 45.0, 80.0), 0), (Cylinder((15, 5, 0), 11.0, 60.0, (0.2, 0, 1)), 1)])


@pytest.mark.parametrize(("pixels", "worst", "rms"), [(32, 3e-3, 5e-4), (64, 4e-3, 5e-4), (128, 4e-3, 5e-4)])
def test_pixel_averages_are_those_of_many_rays(pixels: int, worst: float, rms: float) -> None:
    shapes = [(Voxels(cylinder_map(64), 50 * np.eye(3), np.zeros(3)), (0, 1)), (Sphere((-20, 3, 1), 9.0), 2)]
    frame = Geometry.circular(500.0, 800.0, np.array([0.3]), Panel(pixels, pixels, 192 / pixels)).ray_frames()[0]
    found = expected_counts(frame, pixels, pixels, solids_of(shapes), SPECTRUM)
    assert (found.classes == VOXELS).mean() > 0.5
    chosen = np.argwhere(found.classes > 0)[:: pixels**2 // 200]
    brute = expected_counts_by_grid(frame, chosen, solids_of(shapes), SPECTRUM, n=64)
    error = np.log(found.counts[:, chosen[:, 0], chosen[:, 1]].T / brute)
    assert np.abs(error).max() < worst
    assert np.sqrt((error**2).mean()) < rms


def test_projections_of_a_voxelized_scene_come_closer_with_resolution() -> None:
    frame = Geometry.circular(500.0, 800.0, np.array([0.3]), Panel(32, 32, 6.0)).ray_frames()[0]
    exact = expected_counts(frame, 32, 32, CYLINDERS, SPECTRUM).counts
    errors = []
    for voxels in (16, 32, 64):
        shape = Voxels(cylinder_map(voxels), 50 * np.eye(3), np.zeros(3))
        error = np.log(expected_counts(frame, 32, 32, solids_of([(shape, (0, 1))]), SPECTRUM).counts / exact)
        errors.append(np.sqrt((error**2).mean()))
    assert errors[1] < 0.6 * errors[0]
    assert errors[2] < 0.6 * errors[1]
    assert errors[2] < 0.01


def test_truth_is_the_map_where_grids_coincide_and_its_means_where_they_nest() -> None:
    labels = np.random.default_rng(4).integers(0, 3, (8, 8, 8))
    solids = solids_of([(Voxels(VoxelMap.of_labels(labels, [1, 2]), 4 * np.eye(3), np.zeros(3)), (0, 1))])
    same = fractions(Grid.cube(8, 8.0), solids, 3, background=2)
    np.testing.assert_array_equal(same[:2], np.stack([labels == 1, labels == 2]))
    np.testing.assert_allclose(same[2], labels == 0, atol=1e-12)
    coarse = fractions(Grid.cube(4, 8.0), solids, 2)
    means = np.stack([labels == 1, labels == 2]).reshape(2, 4, 2, 4, 2, 4, 2).mean(axis=(2, 4, 6))
    np.testing.assert_allclose(coarse, means, atol=1e-6)


@pytest.mark.parametrize(
    ("turn", "worst"),
    [(np.eye(3), 1e-6), (np.array([[0, -1, 0], [1, 0, 0], [0, 0, -1.0]]), 1e-6), (TURN, 0.06)],
    ids=["parallel", "quarter", "turned"],
)
def test_truth_on_any_grid_is_counted_points(turn: np.ndarray, worst: float) -> None:
    """Where axes are parallel, grid faces stand at tenths of voxels, so that a point for each tenth counts exactly."""
    axes = turn @ np.diag([3.5, 3.0, 2.5])
    shape = Voxels(VoxelMap.of_labels(LABELS, [1, 2]), axes, np.zeros(3))
    grid = Grid((4, 4, 4), (1.5, 1.5, 1.5), (-2.05, -2.35, -2.55))
    found, n = fractions(grid, solids_of([(shape, (0, 1))]), 2), 15
    part, expected = shape.terms[0][0], np.zeros((2, *grid.shape))
    offsets = np.array(np.meshgrid(*[(np.arange(n) + 0.5) / n - 0.5] * 3)).reshape(3, -1).T
    for voxel in np.ndindex(grid.shape):
        points = (np.array(grid.origin) + (np.array(voxel) + offsets) * np.array(grid.spacing))[:, ::-1]
        expected[(slice(None), *voxel)] = part.voxels.at(part.local[:, :3] @ points.T + part.local[:, 3:]).mean(axis=0)
    assert np.abs(found - expected).max() < worst
    assert found.sum() == pytest.approx(expected.sum(), rel=5e-3)


def test_a_turned_box_leaves_no_gaps_in_what_surrounds_it() -> None:
    full = Voxels(VoxelMap.of_labels(np.ones((4, 4, 4)), [1]), TURN * 5, np.array([0.3, 0.2, 0.1]))
    found = fractions(Grid.cube(24, 24.0), solids_of([(Box((0, 0, 0), (30, 30, 30)), 0), (full, (0,))]), 1)
    np.testing.assert_allclose(found, 1, atol=1e-6)


def test_bounds_and_points_are_those_of_voxels_that_are_not_empty() -> None:
    labels = np.zeros((4, 5, 6), int)
    labels[1, 2:4, 3] = 7
    shape = Voxels(VoxelMap.of_labels(labels, [7]), np.diag([3.0, 2.5, 2.0]), np.zeros(3))
    np.testing.assert_allclose(shape.bounds, [[0, -0.5, -1], [1, 1.5, 0]], atol=1e-12)
    points = np.array([[0.5, 0.5, -0.5], [1.5, 0.5, -0.5], [0.5, 0.5, 9]])
    assert shape.contains(points).tolist() == [True, False, False]


def test_refuses_what_kernels_would_read_beyond() -> None:
    solids = solids_of(AMONG)
    with pytest.raises(InputError, match="name material 2"):
        trace(np.zeros((1, 3)), np.ones((1, 3)), solids, 2)
    with pytest.raises(InputError, match="right angles"):
        Voxels(TURNED.content, np.array([[1.0, 1, 0], [0, 1, 0], [0, 0, 1]]), np.zeros(3))
