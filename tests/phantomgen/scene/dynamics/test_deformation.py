"""Objects that bend: fields of displacements, surfaces in place of solids, and scenes against the same shapes moved."""

from math import pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phantomgen.geometry.voxel_grid import Grid
from phantomgen.scene.dynamics.lattice import Lattice
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import Scan, load_scene
from phantomgen.shapes import Box, Capsule, Cylinder, Ellipsoid, HalfSpace, Intersection, Placed, Sphere, Torus, sweep
from phantomgen.shapes.surfaces import surface_of
from spectra.errors import InputError, SceneError

LOW, HIGH = np.array([-10.0, -8.0, -6.0]), np.array([10.0, 12.0, 14.0])
SCENE = """\
version: 1
name: bending
source: {type: monochromatic, energy: 60, photons: 1.0e6}
detector: {type: photon_counting, thresholds: [20]}
geometry: {type: circular, sod: 100, sdd: 200, views: 8, test_views: 2}
panel: {rows: 9, columns: 11, pitch: 3}
volume: {voxels: 10, size: 20}
time: {duration: 8, signals: {ramp: {type: table, times: [0, 8], values: [0, 1]}}}
objects:
  - {type: box, material: water, size: [4, 3, 8]}
noise: false
"""
SHEAR = "{low: [-9, -9, -9], high: [9, 9, 9], shifts: [[[[-1.8, 0.9, 0]]], [[[1.8, -0.9, 0]]]]}"  # (0.2 z, -0.1 z, 0)
SHEARED = np.array([[1, 0, 0.2], [0, 1, -0.1], [0, 0, 1]])


def bending(*overrides: str) -> Scan:
    return load_scene(SceneFile("bending.yaml", SCENE, overrides))


def lattice_of(counts, field) -> Lattice:
    axes = [np.linspace(low, high, count) for low, high, count in zip(LOW, HIGH, counts, strict=True)]
    z, y, x = np.meshgrid(*axes[::-1], indexing="ij")
    return Lattice(LOW, HIGH, np.stack(field(x, y, z), axis=-1))


def rays(scan: Scan, count: int = 200) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(0)
    starts = random.normal(size=(count, 3))
    starts *= 60 / np.linalg.norm(starts, axis=1, keepdims=True)
    return starts, random.uniform(-5, 5, (count, 3)) - starts


@given(st.tuples(*[st.integers(2, 6)] * 3))
def test_linear_fields_are_exact_and_end_at_the_faces(counts):
    field = lattice_of(counts, lambda x, y, z: (0.1 * x - 0.2 * z, 0.3 * y, 1 + 0.05 * z))
    points = np.array([[0.3, 1.7, 2.2], [-9.0, 11.0, 13.0], [50.0, 2.0, -50.0]])
    x, y, z = np.clip(points, LOW, HIGH).T
    assert field.displacements(points) == pytest.approx(
        np.stack([0.1 * x - 0.2 * z, 0.3 * y, 1 + 0.05 * z], axis=1), abs=1e-12
    )


def test_cubic_fields_are_exact_from_four_points_on():
    field = lattice_of((4, 5, 6), lambda x, y, z: (x**3 / 100, x * y**2 / 50, z**3 / 100 - y))
    points = np.random.default_rng(1).uniform(LOW, HIGH, (50, 3))
    x, y, z = points.T
    assert field.displacements(points) == pytest.approx(
        np.stack([x**3 / 100, x * y**2 / 50, z**3 / 100 - y], axis=1), abs=1e-9
    )


@pytest.mark.parametrize(
    ("shape", "volume"),
    [
        (Sphere((1, 2, 3), 4), 4 / 3 * pi * 64),
        (Ellipsoid((1, 2, 3), (2, 3, 4), (0.3, 0.2, 0.1)), 4 / 3 * pi * 24),
        (Cylinder((0, 1, 0), (2, 3), 5, (1, 1, 1)), pi * 30),
        (Box((0, 1, 0), (2, 3, 4), (0.1, 0.2, 0.3)), 24),
        (Placed(Sphere((0, 0, 0), 1), np.diag([-1.0, 2.0, 3.0]), np.ones(3)), 4 / 3 * pi * 6),
    ],
    ids=lambda value: type(value).__name__,
)
def test_surfaces_have_the_volume_of_their_solids_and_nearly_their_points(shape, volume):
    surface = surface_of(shape)
    assert surface.volume == pytest.approx(volume, rel=1e-9)
    low, high = shape.bounds
    points = np.random.default_rng(0).uniform(low, high, (4000, 3))
    assert np.mean(surface.contains(points) != shape.contains(points)) < 2e-3
    finer = surface_of(shape, 2)
    assert np.abs(np.array(finer.bounds) - shape.bounds).max() < 2e-3 * np.abs(high - low).max()


def test_meshes_keep_their_surface_and_other_shapes_are_refused():
    tube = sweep([(0, 0, 0), (5, 0, 0), (9, 4, 0)], 1.0)
    assert (surface_of(tube).vertices == tube.vertices).all()
    others = [
        Torus((0, 0, 0), 5, 1),
        Capsule((0, 0, 0), 1, 4),
        Intersection((Sphere((0, 0, 0), 2), HalfSpace((0, 0, 1), 0))),
    ]
    for shape in others:
        with pytest.raises(InputError, match="a shape that deforms is a sphere"):
            surface_of(shape)


def test_chords_of_a_sheared_box_are_those_of_a_parallelepiped():
    scan = bending("objects.0.motion={signal: ramp, deform: " + SHEAR + ", shift: [0, 0, 2]}")
    bent = scan.at_time(8.0)
    expected = Placed(Box((0, 0, 0), (4, 3, 8)), SHEARED, np.array([0.0, 0.0, 2.0]))
    still = bending()
    still = still.scene.__class__(**{**vars(still.scene), "objects": ((expected, still.scene.objects[0][1]),)})
    lines = rays(scan)
    assert bent.scene.path_lengths(*lines) == pytest.approx(still.path_lengths(*lines), abs=1e-9)


def test_a_bent_bar_keeps_its_volume_and_lies_along_the_curve():
    shifts = [[[[0, 2.0 * (z / 8) ** 2, 0]]] for z in (-8, -4, 0, 4, 8)]
    motion = {"signal": "ramp", "deform": {"low": [-8, -8, -8], "high": [8, 8, 8], "shifts": shifts}}
    bent = bending(f"objects.0.motion={motion}").at_time(8.0)
    grid = Grid((40, 40, 40), (0.5, 0.5, 0.5), (-9.75, -9.75, -9.75))
    filled = bent.scene.fractions(grid)[0]
    assert filled.sum() * 0.125 == pytest.approx(96, rel=1e-6)
    z, y, _ = np.meshgrid(*(grid.axis(name) for name in "zyx"), indexing="ij")
    for layer in (13, 20, 26):
        middle = (filled * y)[layer].sum() / filled[layer].sum()
        assert middle == pytest.approx(2.0 * (z[layer, 0, 0] / 8) ** 2, abs=0.02)


ALONG_X, ALONG_Y = "[[[[-2, 0, 0], [2, 0, 0]]]]", "[[[[0, -2, 0]], [[0, 2, 0]]]]"  # at -9 and 9 mm


@pytest.mark.parametrize(("of_group", "shifts"), [(True, ALONG_Y), (False, ALONG_X)])
def test_members_of_a_turned_group_bend_in_its_frame_and_with_the_group_in_that_of_the_scene(of_group, shifts):
    motion = "motion: {signal: ramp, deform: {low: [-9, -9, -9], high: [9, 9, 9], shifts: " + shifts + "}}"
    of_whole, of_member = (motion, "clip: []") if of_group else ("clip: []", motion)
    member = f"{{type: sphere, material: water, center: [4.5, 0, 0], radius: 1, {of_member}}}"
    scan = bending(
        f"objects.0={{type: group, center: [0, 0, 3], rotation: [0, 0, 90], {of_whole}, objects: [{member}]}}"
    )
    low, high = scan.at_time(8.0).scene.objects[0][0].bounds
    assert (low + high) / 2 == pytest.approx([0, 5.5, 3], abs=1e-9)
    assert (high - low)[1] == pytest.approx(2 * (1 + 2 / 9), rel=1e-2)


@pytest.mark.parametrize(
    ("deform", "words"),
    [
        (SHEAR.replace("-1.8, 0.9, 0", "0, 0, 30"), "folds space at"),
        (SHEAR.replace("high: [9, 9, 9]", "high: [9, 9, -9]"), "high must exceed low"),
        (SHEAR.replace("[[[1.8, -0.9, 0]]]", "[[[1.8, -0.9, 0], [1, 1, 1]]]"), "as many rows"),
        ("{low: [-9, -9, -9], high: [9, 9, 9]}", "shifts"),
    ],
)
def test_fields_that_cannot_be_are_refused(deform, words):
    with pytest.raises(SceneError, match=words):
        bending("objects.0.motion={signal: ramp, deform: " + deform + "}")


def test_a_group_that_cuts_a_member_that_bends_is_refused_with_its_place():
    member = "{type: sphere, material: water, radius: 4, motion: {signal: ramp, deform: " + SHEAR + "}}"
    with pytest.raises(SceneError, match=r"objects\.0\.clip - a shape that deforms is a sphere.*without clip planes"):
        bending(f"objects.0={{type: group, clip: [{{normal: [0, 0, 1], offset: 1}}], objects: [{member}]}}")
    apart = bending(f"objects.0={{type: group, clip: [{{normal: [0, 0, 1], offset: 9}}], objects: [{member}]}}")
    assert apart.at_time(8.0).scene.objects[0][0].volume == pytest.approx(4 / 3 * np.pi * 64, rel=1e-6)


def test_a_shape_that_cannot_bend_is_refused_with_its_place():
    torus = "{type: torus, material: water, radius: 5, tube: 1, motion: {signal: ramp, deform: " + SHEAR + "}}"
    with pytest.raises(SceneError, match=r"objects\.0\.motion\.deform - a shape that deforms is a sphere.*got torus"):
        bending(f"objects.0={torus}")
