"""Meshes among other shapes: the same counts, fractions and chords as the solid that they describe."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.expected_counts import Spectrum, expected_counts, expected_counts_by_grid
from phantomgen.ops.trace import trace
from phantomgen.ops.voxelize_shapes import fractions
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from phantomgen.shapes import Box, Cylinder, Difference, Mesh, Placed, Shape, Sphere, rotation_matrix, solids_of
from phantomgen.simulation.run import simulate
from spectra.errors import SceneError

TURN = (0.3, 0.5, 0.7)
SPECTRUM = Spectrum(np.array([[0.05, 0.02], [0.2, 0.1]]), np.array([1.0, 2.0]), np.array([0, 1, 2]))


def mesh_of(made: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(made.vertices), np.asarray(made.faces))


CUBE = Placed(mesh_of(trimesh.creation.box((20.0, 30.0, 40.0))), rotation_matrix(TURN), np.array([5.0, 2.0, 3.0]))
SAME = Box((5.0, 2.0, 3.0), (20.0, 30.0, 40.0), TURN)
OTHERS: list[tuple[Shape, int]] = [(Sphere((0, 0, 0), 40.0), 0), (Cylinder((8, 0, 0), 6.0, 60.0), 0)]


def among(shape: Shape) -> list[tuple[Shape, int]]:
    return [OTHERS[0], (shape, 1), OTHERS[1]]


def test_chords_are_those_of_the_solid() -> None:
    rng = np.random.default_rng(5)
    origins, ends = rng.normal(size=(2, 400, 3)) * 60
    found, expected = (trace(origins, ends - origins, solids_of(among(s)), 2) for s in (CUBE, SAME))
    np.testing.assert_allclose(found, expected, atol=1e-10)


def test_fractions_are_those_of_the_solid() -> None:
    grid = Grid.cube(32, 96.0)
    found, expected = (fractions(grid, solids_of(among(s)), 2) for s in (CUBE, SAME))
    np.testing.assert_allclose(found, expected, atol=0.02)
    np.testing.assert_allclose(found.sum(axis=(1, 2, 3)), expected.sum(axis=(1, 2, 3)), rtol=1e-4)


def test_counts_are_those_of_many_rays_and_of_the_solid() -> None:
    frame = Geometry.circular(500.0, 800.0, np.array([0.3]), Panel(48, 48, 4.0)).ray_frames()[0]
    found = expected_counts(frame, 48, 48, solids_of(among(CUBE)), SPECTRUM)
    pixels = np.argwhere(np.ones((48, 48)))
    brute = expected_counts_by_grid(frame, pixels, solids_of(among(CUBE)), SPECTRUM, n=64)
    error = np.abs(np.log(found.counts.reshape(2, -1).T / brute))
    assert error.max() < 1e-2
    assert np.sqrt((error**2).mean()) < 5e-4
    same = expected_counts_by_grid(frame, pixels, solids_of(among(SAME)), SPECTRUM, n=64)
    np.testing.assert_allclose(brute, same, rtol=1e-9)


def test_meshes_can_be_cut_and_mirrored() -> None:
    points = np.random.default_rng(6).uniform(-40, 40, (4000, 3))
    cut, same = (Difference(s, (Sphere((5, 2, 3), 12.0),)) for s in (CUBE, SAME))
    np.testing.assert_array_equal(cut.contains(points), same.contains(points))
    mirror = np.diag([-1.0, 1.0, 1.0])
    mirrored, expected = (Placed(s, mirror, np.zeros(3)) for s in (CUBE, SAME))
    np.testing.assert_array_equal(mirrored.contains(points), expected.contains(points))
    ends = points[:100], points[100:200] - points[:100]
    chords = [trace(*ends, solids_of([(s, 0)]), 1) for s in (mirrored, expected)]
    np.testing.assert_allclose(*chords, atol=1e-10)


SCENE = """\
version: 1
name: meshes
source: {type: monochromatic, energy: 60, photons: 1000}
detector: {type: photon_counting, thresholds: [20]}
geometry: {type: circular, sod: 500, sdd: 800, views: 2}
panel: {rows: 32, columns: 32, pitch: 4}
volume: {voxels: 16, size: 64}
materials: {metal: {composition: Al}}
objects:
  - {type: mesh, material: metal, file: ball.stl, unit: cm, center: [3, 2, 1], scale: 2}
"""


def test_a_scene_with_a_mesh_beside_it(tmp_path: Path) -> None:
    trimesh.creation.icosphere(4, 1.0).export(tmp_path / "ball.stl")
    (tmp_path / "scene.yaml").write_text(SCENE)
    scan = load_scene(tmp_path / "scene.yaml")
    ((shape, _),) = scan.scene.objects
    low, high = shape.bounds
    np.testing.assert_allclose([low, high], [[-17, -18, -19], [23, 22, 21]], atol=1e-3)
    summary = simulate(scan, tmp_path / "scan.h5")
    assert summary.error.edge_worst < 5e-3
    assert not summary.warnings


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("ball.stl", "none.stl"), "none.stl: there is no such file"),
        (("unit: cm", "unit: mile"), "objects.0.unit - input should be 'mm', 'cm'"),
    ],
)
def test_mistakes_are_one_sentence(tmp_path: Path, change: tuple[str, str], words: str) -> None:
    with pytest.raises(SceneError, match=words) as caught:
        load_scene(SceneFile(str(tmp_path / "scene.yaml"), SCENE.replace(*change)))
    assert "\n" not in str(caught.value)
