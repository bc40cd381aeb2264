"""Objects that add up: sums of chords, sums at points, the Shepp-Logan head, and one sentence per mistake."""

import numpy as np
import pytest

from phantomgen.ops.trace import trace
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.objects.overlap import Arrangement
from phantomgen.scene.scan import load_scene
from phantomgen.shapes import Box, Cylinder, Sphere, solids_of
from spectra.errors import SceneError

HEAD = """\
version: 1
name: toy
source: {type: monochromatic, energy: 60, photons: 1000}
detector: {type: photon_counting, thresholds: [20]}
geometry: {type: circular, sod: 500, sdd: 800, views: 2}
panel: {rows: 16, columns: 16, pitch: 8}
volume: {voxels: 16, size: 64}
basis: [{type: photoelectric}, {type: compton}]
overlap: %s
materials:
  base: {coefficients: {photoelectric: 0.003, compton: 0.02}}
  more: {coefficients: {compton: 0.004}}
  less: {coefficients: {photoelectric: -0.0003, compton: -0.002}}
  none: {coefficients: {photoelectric: -0.003, compton: -0.02}}
  water: {composition: H2O, density: 1}
"""
# boxes, cones, tubes, rings, cutting planes, copies that overlap each other, a hole that goes down to nothing
CROWD = """\
objects:
  - {type: box, material: base, size: [60, 60, 60]}
  - {type: sphere, material: less, radius: 20}
  - {type: cylinder, material: more, radius: 15, length: 70, axis: [1, 1, 0]}
  - {type: sphere, material: less, center: [12, 0, 0], radius: 9, repeat: {type: ring, count: 5}}
  - {type: cone, material: more, center: [0, 0, 10], radii: [12, 3], length: 30}
  - {type: tube, material: more, center: [5, 0, 0], radius: 12, inner_radius: 9, length: 30}
  - {type: torus, material: more, center: [0, 10, -5], radius: 14, tube: 4, axis: [1, 0, 1]}
  - {type: ellipsoid, material: less, center: [-15, 0, 0], radii: [12, 8, 25], clip: [{normal: [1, 0, 1], offset: -12}]}
"""
HOLE = "objects: [{type: sphere, material: base, radius: 20}, {type: box, material: none, size: [9, 9, 9]}]"


def scan_of(objects: str, overlap: str = "add"):
    return load_scene(SceneFile("toy.yaml", HEAD % overlap + objects))


@pytest.mark.parametrize(("objects", "regions"), [(CROWD, 60), (HOLE, 2)])
def test_line_integrals_are_sums_of_single_objects(objects: str, regions: int) -> None:
    scan, file = scan_of(objects), SceneFile("toy.yaml", HEAD % "replace" + objects)
    scene = scan.scene
    assert len(scene.objects) >= regions
    rng = np.random.default_rng(1)
    starts, ends = rng.uniform(-40, 40, (2, 400, 3))
    lengths = trace(starts, ends - starts, scene.solids, len(scene.materials))
    found = lengths @ [[m.coefficients.get(f, 0.0) for f in ("photoelectric", "compton")] for m in scene.materials]

    from phantomgen.scene.objects.build import objects_of

    wanted = np.zeros((400, 2))
    for shape, name, _ in objects_of(file):
        chord = trace(starts, ends - starts, solids_of([(shape, 0)]), 1)
        coefficients = file.model.materials[name].coefficients
        wanted += chord * [coefficients.get(f, 0.0) for f in ("photoelectric", "compton")]
    np.testing.assert_allclose(found, wanted, atol=1e-11)


def test_order_does_not_matter() -> None:
    lines = CROWD.splitlines()
    here, there = scan_of(CROWD).scene, scan_of("\n".join([lines[0], *lines[:0:-1]])).scene
    points = np.random.default_rng(2).uniform(-35, 35, (2000, 3))

    def values(scene) -> np.ndarray:
        found = np.zeros(len(points))
        for shape, material in scene.objects:
            found[shape.contains(points)] = scene.materials[material].coefficients.get("compton", 0.0)
        return found

    np.testing.assert_allclose(values(here), values(there), atol=1e-12)


# Half axes, centre, angle about z, value: Kak & Slaney 1988, p. 102, with errata
SHEPP_LOGAN = [
    (0.69, 0.92, 0.9, 0, 0, 0, 0, 2.0),
    (0.6624, 0.874, 0.88, 0, 0, 0, 0, -0.98),
    (0.41, 0.16, 0.21, -0.22, 0, -0.25, 108, -0.02),
    (0.31, 0.11, 0.22, 0.22, 0, -0.25, 72, -0.02),
    (0.21, 0.25, 0.5, 0, 0.35, -0.25, 0, 0.02),
    (0.046, 0.046, 0.046, 0, 0.1, -0.25, 0, 0.02),
    (0.046, 0.023, 0.02, -0.08, -0.65, -0.25, 0, 0.01),
    (0.046, 0.023, 0.02, 0.06, -0.65, -0.25, 90, 0.01),
    (0.056, 0.04, 0.1, 0.06, -0.105, 0.625, 90, 0.02),
    (0.056, 0.056, 0.1, 0, 0.1, 0.625, 0, -0.02),
]


def test_the_shepp_logan_head_has_the_published_values() -> None:
    scene = load_scene("shepp-logan-3d", ["geometry.views=1", "geometry.test_views=0"]).scene
    rng = np.random.default_rng(3)
    centres = np.array([row[3:6] for row in SHEPP_LOGAN])
    points = np.concatenate([rng.uniform(-1, 1, (20000, 3)), *(rng.normal(c, 0.05, (500, 3)) for c in centres)])
    wanted = np.zeros(len(points))
    for a, b, c, x, y, z, degrees, value in SHEPP_LOGAN:
        t = np.deg2rad(degrees)
        dx, dy, dz = (points - [x, y, z]).T
        along, across = dx * np.cos(t) + dy * np.sin(t), dy * np.cos(t) - dx * np.sin(t)
        wanted += value * ((along / a) ** 2 + (across / b) ** 2 + (dz / c) ** 2 < 1)
    found = np.zeros(len(points))
    for shape, material in scene.objects:
        found[shape.contains(100 * points)] = scene.materials[material].coefficients["compton"] / 0.01788
    np.testing.assert_allclose(found, wanted, atol=1e-9)
    # the printed picture: skull, brain, ventricles, the tumours near the bottom, the bright ellipse above
    assert {2.0, 1.02, 1.0, 1.03, 1.04} <= set(wanted.round(3))


def test_equal_sums_share_a_material_with_a_readable_name() -> None:
    names = [
        m.name for m in load_scene("shepp-logan-3d", ["geometry.views=1", "geometry.test_views=0"]).scene.materials
    ]
    assert names[:2] == ["skull", "skull + hollow"]
    assert "skull + hollow + 2 plus_2_percent" in names
    assert len(names) == 6


def test_shapes_that_enclose_others_are_not_cut_again() -> None:
    nested = [Sphere((0, 0, 0), 30.0 - i) for i in range(12)]
    arrangement = Arrangement((*nested, Cylinder((0, 0, 0), 5, 10), Box((40, 0, 0), (30, 5, 5))))
    regions = arrangement.regions()
    assert len(regions) == 13 + 1 + 5  # a chain, the box, and the box in those spheres that it reaches
    assert arrangement.common(frozenset(range(13))) is arrangement.shapes[12]


def test_equal_shapes_add_up() -> None:
    scan = scan_of(f"objects: [{', '.join(['{type: sphere, material: base, radius: 5}'] * 3)}]")
    assert [m.name for m in scan.scene.materials] == ["3 base"]
    assert scan.scene.materials[0].coefficients == pytest.approx({"photoelectric": 0.009, "compton": 0.06})


@pytest.mark.parametrize(
    ("objects", "words"),
    [
        (
            "objects: [{type: sphere, material: water, radius: 1}]",
            "toy.yaml:15:10: materials.water - 'overlap: add' sums",
        ),
        (
            "objects: [{type: sphere, material: less, radius: 1}]",
            "'less' add up to a compton coefficient of -0.002 1/mm",
        ),
        (
            HOLE.replace("none", "less").replace("base", "more"),
            "toy.yaml:9:10: overlap - 'more + less' add up to a photoelectric coefficient of -0.0003 1/mm",
        ),
        ("background: base\n" + HOLE, "background - 'overlap: add' knows no background"),
        (
            "objects: [{type: sphere, material: base, radius: 30, center: [1, 0, 0], repeat: {type: ring, count: 12}}]",
            "objects overlap in more than 2000 ways",
        ),
    ],
)
def test_mistakes_are_one_sentence(objects: str, words: str) -> None:
    with pytest.raises(SceneError) as caught:
        scan_of(objects)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_negative_coefficients_need_adding_up() -> None:
    with pytest.raises(
        SceneError, match=r"materials\.less - coefficients of material 'less' must be finite and not neg"
    ):
        scan_of("objects: [{type: sphere, material: base, radius: 1}]", "replace")
