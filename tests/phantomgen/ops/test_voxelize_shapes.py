"""Volume fractions: closed-form volumes, point counts, priority, and independence of the grid."""

import numpy as np
import pytest

from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.trace import trace
from phantomgen.ops.voxelize_shapes import fractions
from phantomgen.ops.voxelize_shapes.reference import fractions_by_points
from phantomgen.shapes import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Difference,
    Ellipsoid,
    HalfSpace,
    Intersection,
    Polygon,
    Shape,
    Sphere,
    Torus,
    Tube,
    solids_of,
)


def filled(grid: Grid, objects: list[tuple[Shape, int]], count: int = 1, background: int = -1) -> np.ndarray:
    return fractions(grid, solids_of(objects), count, background)


@pytest.mark.parametrize(
    ("shape", "tolerance"),
    [
        (Cylinder((0, 0, 0), 50.0, 100.0), 1e-7),
        (Cylinder((-22, 6, 0.3), 13.0, 80.0), 1e-7),
        (Box((1, 2, 3), (10.2, 20.3, 30.1)), 1e-7),
        (Sphere((1, 2, 3), 20.3), 1e-6),
        (Sphere((1.2, 2, 3), 0.3), 1e-6),
        (Ellipsoid((1, 2, 3), (10, 20, 30), (0.3, 0.4, 0.5)), 1e-6),
        (Cylinder((1, 2, 3), 10.2, 40.3, (1, 2, 3)), 1e-6),
        (Cylinder((1, 2, 3), (10.2, 4.1), 40.3, (1, 0, 0)), 2e-5),
        (Box((1, 2, 3), (10.2, 20.3, 30.1), (0.3, 0.4, 0.5)), 1e-6),
        (Cylinder((1, 2, 3), 0.05, 60.0, (1, 1, 0)), 1e-3),
        (Tube((1, 2, 3), 20.3, 15.2, 30.1), 1e-7),
        (Tube((1, 2, 3), 20.3, 15.2, 30.1, (1, 2, 3)), 1e-6),
        (Capsule((1, 2, 3), 10.3, 30.1, (1, 2, 3)), 1e-6),
        (Cone((1, 2, 3), (0.0, 20.3), 30.1, (1, 2, 3)), 1e-5),
        (Cone((1, 2, 3), (20.3, 7.1), 30.1), 1e-5),
        (Torus((1, 2, 3), 20.3, 7.1, (1, 2, 3)), 5e-4),
        (Polygon(((0, 20), (5, 5), (20, 0), (0, -20), (-20, 0)), 30.1, (1, 2, 3), (0.3, 0.4, 0.5)), 1e-4),
    ],
    ids=repr,
)
def test_summed_volume(shape: Shape, tolerance: float) -> None:
    grid = Grid.cube(64, 128.0)
    volume = filled(grid, [(shape, 0)]).sum(dtype=np.float64) * grid.voxel_volume
    assert volume == pytest.approx(shape.volume, rel=tolerance)


def test_override_and_nesting() -> None:
    outer, inner = Cylinder((0, 0, 0), 20.0, 40.0), Cylinder((3, 2, 0), 6.5, 30.0)
    grid = Grid.cube(32, 64.0)
    both = filled(grid, [(outer, 0), (inner, 1)], 2).sum(axis=(1, 2, 3), dtype=np.float64) * grid.voxel_volume
    np.testing.assert_allclose(both, [outer.volume - inner.volume, inner.volume], rtol=1e-6)
    hidden = filled(grid, [(inner, 1), (outer, 0)], 2)
    assert hidden[1].max() == 0


@pytest.mark.parametrize(
    "shape",
    [
        Sphere((0.2, 0.1, 0.0), 2.2),
        Box((0, 0, 0), (3, 4, 5), (0.3, 0.5, 0.7)),
        Cone((0, 0, 0), (2.5, 0.0), 5.0, (1, 2, 1)),
        Torus((0, 0, 0), 2.0, 0.9, (1, 2, 3)),
        Difference(Sphere((0, 0, 0), 2.5), (Cylinder((0, 0, 0), 1.0, 8.0, (1, 1, 1)),)),
    ],
    ids=lambda shape: type(shape).__name__,
)
def test_no_partial_volume_is_wrong_by_a_thousandth_of_a_voxel(shape: Shape) -> None:
    grid, lines = Grid.cube(5, 6.0), 256
    solids = solids_of([(shape, 0)])
    found = fractions(grid, solids, 1)[0]
    ((_, dy, dx), (_, y, x)), places = (grid.spacing, grid.origin), (np.arange(lines) + 0.5) / lines - 0.5
    row, column = 1, 3
    ys, xs = np.meshgrid(y + (row + places) * dy, x + (column + places) * dx, indexing="ij")
    for k in range(5):
        foot = np.column_stack([xs.ravel(), ys.ravel(), np.full(lines**2, -3.0 + 1.2 * k)])
        chords = trace(foot, np.broadcast_to([0.0, 0.0, 1.2], foot.shape), solids, 1)
        assert found[k, row, column] == pytest.approx(chords.mean() / 1.2, abs=1e-3)


def test_against_counted_points() -> None:
    objects: list[tuple[Shape, int]] = [
        (Sphere((0.2, 0.1, 0.0), 2.2), 0),
        (Box((1, 0, 0.5), (2, 1.5, 2.5), (0.3, 0.5, 0.7)), 1),
        (Cylinder((0, 0, -1), 0.8, 3.0, (1, 2, 1)), 0),
    ]
    grid = Grid((3, 4, 5), (1.7, 1.3, 1.1), (-1.6, -1.9, -2.3))
    arrays = solids_of(objects)
    counted = fractions_by_points(grid, arrays, 3, 12, 2)
    found = filled(grid, objects, 3, background=2)
    np.testing.assert_allclose(found.sum(axis=0), 1, rtol=1e-6)
    np.testing.assert_allclose(found, counted, atol=0.02)
    assert np.abs(found - counted).mean() < 2e-3


def test_shape_beyond_the_grid_is_cut() -> None:
    found = filled(Grid.cube(8, 8.0), [(Box((0, 0, 0), (100, 100, 100)), 0)])
    assert (found == 1).all()
    outside = filled(Grid.cube(8, 8.0), [(Sphere((50, 0, 0), 3.0), 0)])
    assert (outside == 0).all()


def test_coarse_grid_is_the_mean_of_a_fine_one() -> None:
    objects: list[tuple[Shape, int]] = [(Cylinder((1, 0, 2), 9.3, 21.7), 0)]
    coarse, fine = filled(Grid.cube(16, 32.0), objects)[0], filled(Grid.cube(32, 32.0), objects)[0]
    np.testing.assert_allclose(coarse, fine.reshape(16, 2, 16, 2, 16, 2).mean(axis=(1, 3, 5)), atol=1e-6)


@pytest.mark.parametrize(
    "shape",
    [
        Sphere((1, 2, 3), 20.3),
        Ellipsoid((1, 2, 3), (10, 20, 30), (0.3, 0.4, 0.5)),
        Cylinder((1, 2, 3), 10.2, 40.3, (1, 2, 3)),
        Cylinder((1, 2, 3), 10.2, 40.3),
        Box((1, 2, 3), (10.2, 20.3, 30.1), (0.3, 0.4, 0.5)),
        Cone((1, 2, 3), (20.3, 7.1), 30.1, (1, 2, 3)),
        Torus((1, 2, 3), 20.3, 7.1, (1, 2, 3)),
        Difference(Box((1, 2, 3), (30.2, 20.3, 30.1)), (Sphere((4, 2, 3), 12.0),)),
        Intersection((Sphere((1, 2, 3), 20.3), HalfSpace((1.0, 0.5, 0.7), 6.0))),
    ],
    ids=repr,
)
def test_layers_of_crowded_scenes_agree_with_whole_columns(shape: Shape, monkeypatch: pytest.MonkeyPatch) -> None:
    grid = Grid.cube(24, 72.0)
    objects = [(shape, 0), (Sphere((-6.0, 3.0, 2.5), 7.0), 1)]
    whole = filled(grid, objects, 2)
    monkeypatch.setattr("phantomgen.ops.voxelize_shapes.CROWDED", 0)
    layers = filled(grid, objects, 2)
    # Each is right to some 3e-4 of a voxel.
    np.testing.assert_allclose(layers, whole, atol=6e-4)
    np.testing.assert_allclose(layers.sum(axis=(1, 2, 3)), whole.sum(axis=(1, 2, 3)), rtol=5e-5)
