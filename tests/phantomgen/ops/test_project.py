"""The voxel projector: its matrix, its transpose, exact chords, and rays that naive code counts twice or not at all."""

import numpy as np
import pytest
from scipy.ndimage import maximum_filter, minimum_filter

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.project import project, project_transpose, values_of_averages
from phantomgen.ops.project.reference import matrix_of_view
from phantomgen.ops.trace import trace, trace_view
from phantomgen.ops.voxelize_shapes import fractions
from phantomgen.shapes import Box, Cylinder, Sphere, solids_of
from spectra.errors import InputError
from spectra.threads import set_threads

GRID = Grid((5, 6, 7), (1.3, 0.9, 1.1), (-2.0, -3.0, -2.5))
CUBE = Grid.cube(8, 8.0)
CIRCLE = Geometry.circular(15.0, 30.0, np.arange(6) * 0.7, Panel(6, 8, (0.9, 1.1))).ray_frames()
# Beams up to two voxels wide, and wider ones, some in the same column.
WIDE, WIDEST = (
    Geometry.circular(15.0, 30.0, np.arange(6) * 0.7, Panel(6, 8, (pitch, pitch))).ray_frames() for pitch in (2.3, 4.0)
)
ASKEW = np.random.default_rng(3).normal(size=(3, 3))
TILTED = np.stack([np.array([15, 4, 3.0]), np.array([-27, -12, -3.0]), *ASKEW[:2]])[None]
STEEP = np.array([[[1.0, 0.5, 20], [-4, -3.5, -33], [1.1, 0.2, 0.1], [0.1, 1.2, -0.1]]])
PARALLEL = np.array([[[-30.0, 9, 4], [12.0, -7, -5], [0.3, 0.9, 0.1], [0, 0.1, 0.8]]])
UPRIGHT = np.array([[[-30.0, 9, 4], [12.0, -7, -5], [0.3, 0.9, 0.1], [0, 0, 0.8]]])
INSIDE = np.array([[[0.3, 0.2, 0.1], [-1.5, -6.5, -2], [0.4, 0, 0], [0, 0, 0.7]]])
VIEWS = {
    "circle": (CIRCLE, False),
    "wide": (WIDE, False),
    "widest": (WIDEST, False),
    "tilted": (TILTED, False),
    "steep": (STEEP, False),
    "inside": (INSIDE, False),
    "parallel": (PARALLEL, True),
    "upright": (UPRIGHT, True),
}
views = pytest.mark.parametrize(("frames", "parallel"), VIEWS.values(), ids=VIEWS)


@views
def test_both_ways_are_those_of_the_matrix(frames: np.ndarray, parallel: bool) -> None:
    rng = np.random.default_rng(1)
    volume, images = rng.random((2, *GRID.shape)), rng.random((2, len(frames), 6, 8))
    matrix = np.concatenate([matrix_of_view(frame, 6, 8, GRID, parallel) for frame in frames])
    assert matrix.sum() > 50  # the views do meet the volume
    found = project(volume, GRID, frames, 6, 8, parallel)
    np.testing.assert_allclose(found.reshape(2, -1), volume.reshape(2, -1) @ matrix.T, rtol=1e-6, atol=1e-6)
    found = project_transpose(images, GRID, frames, parallel)
    np.testing.assert_allclose(found.reshape(2, -1), images.reshape(2, -1) @ matrix, rtol=1e-6, atol=1e-6)


def fan(pitch: float, height: float = 1.0, rise: float = 0.0) -> np.ndarray:
    """Rays to nine pixels of one row on a circle, `rise` mm higher at the panel than at the source."""
    frames = Geometry.circular(15.0, 30.0, np.arange(11) * 0.6, Panel(1, 9, (height, pitch))).ray_frames()
    frames[:, 1, 2] += rise
    return frames


SLICE = Grid((1, 6, 7), (1.3, 0.9, 1.1), (0.1, -3.0, -2.5))
ROWS = {
    "narrow": (fan(0.8), False),
    "wide": (fan(2.3), False),
    "widest": (fan(7.0, 4.0), False),
    "rising": (fan(1.4, 1.9, 1.5), False),
    "beside": (fan(1.4, 0.5, 3.0), False),
    "inside": (INSIDE, False),
    "parallel": (np.array([[[-30.0, 9, 0.5], [12.0, -7, -0.2], [0.3, 1.2, 0], [0, 0, 0.8]]]), True),
    "upright": (np.array([[[9.0, 30, 0], [-7, -12, 0.2], [1.9, 0.3, 0], [0, 0, 0.8]]]), True),
}
one_row = pytest.mark.parametrize(("frames", "parallel"), ROWS.values(), ids=ROWS)


@one_row
def test_one_row_through_one_slice_is_the_matrix(frames: np.ndarray, parallel: bool) -> None:
    rng, columns = np.random.default_rng(5), 9
    volume, images = rng.random((5, *SLICE.shape)), rng.random((5, len(frames), 1, columns))
    matrix = np.concatenate([matrix_of_view(frame, 1, columns, SLICE, parallel) for frame in frames])
    assert matrix.sum() > 3  # the views do meet the slice
    found = project(volume, SLICE, frames, 1, columns, parallel)
    np.testing.assert_allclose(found.reshape(5, -1), volume.reshape(5, -1) @ matrix.T, rtol=1e-6, atol=1e-6)
    found = project_transpose(images, SLICE, frames, parallel)
    np.testing.assert_allclose(found.reshape(5, -1), images.reshape(5, -1) @ matrix, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("components", [1, 2, 3, 4, 5, 10])
@pytest.mark.parametrize(("frames", "parallel"), [VIEWS["circle"], VIEWS["widest"], VIEWS["tilted"]])
def test_components_are_projected_as_each_alone(frames: np.ndarray, parallel: bool, components: int) -> None:
    rng = np.random.default_rng(4)
    volume, images = rng.random((components, *GRID.shape)), rng.random((components, len(frames), 6, 8))
    alone = np.concatenate([project(v[None], GRID, frames, 6, 8, parallel) for v in volume])
    np.testing.assert_allclose(project(volume, GRID, frames, 6, 8, parallel), alone, rtol=1e-6, atol=1e-6)
    alone = np.concatenate([project_transpose(i[None], GRID, frames, parallel) for i in images])
    np.testing.assert_allclose(project_transpose(images, GRID, frames, parallel), alone, rtol=1e-6, atol=1e-6)


@views
def test_one_is_the_transpose_of_the_other(frames: np.ndarray, parallel: bool) -> None:
    rng, grid = np.random.default_rng(2), Grid((70, 9, 11), (0.1, 0.7, 0.6), (-3.0, -3.0, -3.0))
    x, y = rng.random((3, *grid.shape), np.float32), rng.random((3, len(frames), 12, 16), np.float32)
    forward = project(x, grid, frames, 12, 16, parallel).astype(np.float64)
    backward = project_transpose(y, grid, frames, parallel).astype(np.float64)
    assert (forward * y).sum() == pytest.approx((x * backward).sum(), rel=1e-6)
    assert (forward * y).sum() > 30


def test_same_numbers_whatever_the_threads() -> None:
    rng, frames, rows = np.random.default_rng(4), np.concatenate([CIRCLE, TILTED]), fan(2.3)
    x, y, row = rng.random((2, *GRID.shape)), rng.random((2, 7, 6, 8)), rng.random((2, len(rows), 1, 9))
    results = []
    for threads in (1, 3):
        set_threads(threads)
        both_ways = project(x, GRID, frames, 6, 8), project_transpose(y, GRID, frames)
        results.append((*both_ways, project(x[:, :1], SLICE, rows, 1, 9), project_transpose(row, SLICE, rows)))
    set_threads(None)
    for one, other in zip(*results, strict=True):
        np.testing.assert_array_equal(one, other)


def along(way: tuple, across: tuple, shift: float) -> np.ndarray:
    """Parallel rays along `way`, half a voxel apart, `shift` voxels beside the axis of the cube."""
    way, across = np.array(way, float), np.array(across, float)
    across /= np.linalg.norm(across)
    up = np.cross(way, across) / np.linalg.norm(way)
    way *= 40 / np.linalg.norm(way)
    corner = -way / 2 + (shift - 15) * 0.5 * (across + up)
    return np.stack([way, corner, 0.5 * across, 0.5 * up])[None]


@pytest.mark.parametrize("shift", [0.0, 1.0, 0.5, 0.123], ids=["faces", "edges", "middles", "between"])
@pytest.mark.parametrize(
    ("way", "across"),
    [
        ((1, 0, 0), (0, 1, 0)),
        ((0, -1, 0), (0, 0, 1)),
        ((0, 0, 1), (1, 0, 0)),
        ((1, 1, 0), (1, -1, 0)),
        ((0, 1, -1), (1, 0, 0)),
        ((1, 1, 1), (1, -1, 0)),
        ((3, 1, 0), (0, 0, 1)),
    ],
    ids=str,
)
def test_rays_along_faces_edges_and_corners_are_counted_once(way: tuple, across: tuple, shift: float) -> None:
    """The sum is the volume; each ray lies between the chords less than a voxel beside it, along faces half way."""
    frames = along(way, across, shift)
    found = project(np.ones((1, 8, 8, 8)), CUBE, frames, 32, 32, parallel=True)[0, 0]
    assert found.sum() * 0.25 == pytest.approx(512, rel=3e-3)
    if sorted(map(abs, way)) == [0, 0, 1]:
        part = np.clip(4.5 - np.abs(np.arange(32) - 15 + shift) * 0.5, 0, 1)
        np.testing.assert_allclose(found, 8 * np.outer(part, part), atol=1e-5)
        return
    v, u = np.indices((32, 32))
    starts = (frames[0, 1] + u[..., None] * frames[0, 2] + v[..., None] * frames[0, 3]).reshape(-1, 3)
    box = solids_of([(Box((0, 0, 0), (8, 8, 8)), 0)])
    chords = trace(starts, np.tile(frames[0, 0], (len(starts), 1)), box, 1).reshape(32, 32)
    assert (found > minimum_filter(chords, 3) - 0.01).all()
    assert (found < maximum_filter(chords, 3) + 0.01).all()


def test_rays_end_with_source_and_panel() -> None:
    ones = np.ones((1, 8, 8, 8))
    source, step = np.zeros(3), 0.001 * np.eye(3)
    inside = np.stack([source, [20, 0, 0], *step[1:]])
    before = np.stack([[10, 0, 0], [20, 0, 0], *step[1:]])
    panel = np.stack([[-20, 0, 0], [21.25, 0, 0], *step[1:]])
    short = np.stack([[-20, 0, 0], [15, 0, 0], *step[1:]])
    found = project(ones, CUBE, np.stack([inside, before, panel, short]), 1, 1)
    np.testing.assert_allclose(found.ravel(), [4, 0, 5.25, 0], atol=1e-5)
    turned = np.stack([inside, before, panel, short])[:, :, [1, 2, 0]]
    np.testing.assert_allclose(project(ones, CUBE, turned, 1, 1).ravel(), [4, 0, 5.25, 0], atol=1e-5)


@pytest.mark.parametrize(("pixels", "limit"), [(96, 0.45), (48, 0.2), (12, 0.06)], ids=["fine", "equal", "coarse"])
def test_chords_through_what_was_voxelized(pixels: int, limit: float) -> None:
    """Rms against pixel averages of exact chords [mm], for voxels of 2 mm and pixels of 1, 2 and 8 mm."""
    solids = solids_of([(Sphere((9, -5, 4), 16.0), 0), (Cylinder((-10, 8, -2), 11.0, 40.0, (1, 2, 3)), 0)])
    grid, n = Grid.cube(48, 96.0), 384 // pixels
    frames = Geometry.circular(500.0, 800.0, np.array([0.0, 0.5]), Panel(pixels, pixels, 153.6 / pixels)).ray_frames()
    found = project(fractions(grid, solids, 1), grid, frames, pixels, pixels)[0]
    for frame, image in zip(frames, found, strict=True):
        at = (np.arange(384) + 0.5) / n - 0.5
        ways = (frame[1] + at[:, None] * frame[2] + at[:, None, None] * frame[3]).reshape(-1, 3)
        chords = trace(np.broadcast_to(frame[0], ways.shape), ways, solids, 1).reshape(pixels, n, pixels, n)
        error = image - chords.mean(axis=(1, 3))
        assert np.sqrt((error**2).mean()) < limit
        assert abs(error.sum()) < 2e-3 * chords.mean(axis=(1, 3)).sum()


def test_an_interpolant_has_the_averages_it_was_made_for() -> None:
    """Up to fourth derivatives, as its average over voxel i is (v_(i-1) + 6 v_i + v_(i+1)) / 8 along each axis."""
    z, y, x = np.indices((24, 24, 24)) - 11.5
    averages = np.exp(-((x - 1) ** 2 + y**2 + (z + 2) ** 2) / 2 / 4.0**2)
    found = values_of_averages(averages)
    before = abs(found - averages)[4:-4, 4:-4, 4:-4].max()
    for axis in range(3):
        found = found + (np.roll(found, 1, axis) - 2 * found + np.roll(found, -1, axis)) / 8
    assert abs(found - averages)[4:-4, 4:-4, 4:-4].max() < 0.06 * before


def test_chords_through_averages_are_nearer_with_values_of_averages() -> None:
    solids = solids_of([(Sphere((9, -5, 4), 16.0), 0), (Cylinder((-10, 8, -2), 11.0, 40.0, (1, 2, 3)), 0)])
    grid, panel = Grid.cube(48, 96.0), Panel(64, 64, 2.4)
    frames = Geometry.circular(500.0, 800.0, np.array([0.0, 0.5]), panel).ray_frames()
    averages = fractions(grid, solids, 1)
    wanted = np.stack([trace_view(frame, 64, 64, solids, 1)[..., 0] for frame in frames])
    with_values, plain = (
        np.sqrt(((project(v, grid, frames, 64, 64)[0] - wanted) ** 2).mean())
        for v in (values_of_averages(averages), averages)
    )
    assert with_values < 0.8 * plain


@pytest.mark.wrong_types
def test_refuses_what_does_not_fit() -> None:
    with pytest.raises(InputError, match="must end with these axes"):
        project(np.zeros((1, 2, 2, 2)), CUBE, CIRCLE, 6, 8)
    with pytest.raises(InputError, match="images of 6 views"):
        project_transpose(np.zeros((1, 5, 6, 8)), GRID, CIRCLE)
    with pytest.raises(InputError, match="four finite vectors"):
        project(np.zeros((1, 8, 8, 8)), CUBE, np.full((1, 4, 3), np.nan), 6, 8)
