"""Objects of scene files: every type, groups, patterns, planes, the background, and one sentence per mistake."""

from pathlib import Path

import numpy as np
import pytest

from phantomgen.dataset.truth import read_truth
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.run import simulate
from spectra.errors import SceneError

ZOO = Path(__file__).parents[4] / "examples" / "shapes.yaml"
SMALL = ("panel.rows=32", "panel.columns=32", "panel.pitch=6.4", "geometry.views=2", "geometry.test_views=0")
HEAD = """\
version: 1
name: toy
source: {type: monochromatic, energy: 60, photons: 1000}
detector: {type: photon_counting, thresholds: [20]}
geometry: {type: circular, sod: 500, sdd: 800, views: 2}
panel: {rows: 16, columns: 16, pitch: 8}
volume: {voxels: 16, size: 64}
materials:
  water: {composition: H2O, density: 1}
  metal: {composition: Al}
"""


def scan_of(text: str):
    return load_scene(SceneFile("toy.yaml", HEAD + text))


@pytest.mark.slow
def test_all_shapes_at_once(tmp_path: Path) -> None:
    scan = load_scene(ZOO, [*SMALL, "volume.voxels=32"])
    assert len(scan.scene.objects) == 8 + 1 + 6 + 1 + 4 + 1
    assert scan.scene.materials[scan.scene.background].name == "air"
    error = simulate(scan, tmp_path / "zoo.h5").error
    assert error.edge_worst < 5e-3
    truth = read_truth(tmp_path / "zoo.h5")
    assert truth is not None
    np.testing.assert_allclose(truth.fractions.sum(axis=0, dtype=np.int64), 65535, atol=2)


def test_groups_scale_turn_and_move() -> None:
    ((shape, _),) = scan_of("""\
objects:
  - type: group
    center: [1, 2, 3]
    rotation: [0, 0, 90]
    scale: [2, 1, 1]
    objects: [{type: sphere, material: water, center: [5, 0, 0], radius: 1}]
""").scene.objects
    low, high = shape.bounds
    np.testing.assert_allclose((low + high) / 2, [1, 12, 3], atol=1e-12)
    np.testing.assert_allclose(high - low, [2, 4, 2], atol=1e-12)


def test_patterns() -> None:
    scan = scan_of("""\
objects:
  - {type: sphere, material: water, radius: 1, repeat: {type: grid, count: [2, 1, 3], step: [10, 10, 5]}}
  - {type: sphere, material: metal, center: [9, 0, 0], radius: 1, repeat: {type: ring, count: 4}}
""")
    centres = np.array([np.mean(shape.bounds, axis=0) for shape, _ in scan.scene.objects])
    np.testing.assert_allclose(centres[:6], [[x, 0, z] for x in (-5, 5) for z in (-5, 0, 5)], atol=1e-12)
    np.testing.assert_allclose(centres[6:], [[9, 0, 0], [0, 9, 0], [-9, 0, 0], [0, -9, 0]], atol=1e-12)


def test_planes_cut_in_the_coordinates_of_the_group() -> None:
    text = "objects: [{type: group, center: [9, 0, 0], objects: [{type: sphere, material: water, radius: 5, %s}]}]\n"
    ((half, _),) = scan_of(text % "clip: [{normal: [2, 0, 0], offset: 1}]").scene.objects
    assert half.contains(np.array([[9.9, 0, 0], [10.1, 0, 0], [5, 0, 0]])).tolist() == [True, False, True]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("objects: [{type: sphere, radius: 1}]", "objects.0.material - is missing"),
        ("objects: [{type: sphere, material: metl, radius: 1}]", "did you mean 'metal'"),
        (
            "background: watr\nobjects: [{type: sphere, material: metal, radius: 1}]",
            "toy.yaml:11:13: background - unknown",
        ),
        (
            "objects: [{type: union, material: water, shapes: [{type: sphere, material: metal, radius: 1}]}]",
            "objects.0.shapes.0.material - belongs to the whole object",
        ),
        (
            "objects: [{type: group, material: water, objects: [{type: sphere, material: metal, radius: 1}]}]",
            "objects.0.material - belongs to the whole object",
        ),
        ("objects: [{type: group, objects: [{type: sphere, radius: 1}]}]", "objects.0.objects.0.material - is missing"),
        ("objects: [{type: torus, material: water, radius: 1, tube: 2}]", "objects.0 - torus tube 2 must be smaller"),
        (
            "objects: [{type: polygon, material: water, length: 1, points: [[0, 0], [1, 1], [1, 0], [0, 1]]}]",
            "polygon edges 0 and 2 cross",
        ),
        (
            "objects: [{type: difference, material: water, base: {type: sphere, radius: 2},"
            " cut: [{type: sphere, radius: -1}]}]",
            "objects.0.cut.0.radius - input should be greater than 0",
        ),
        ("objects: [{type: sphere, material: water, radius: 1, clip: [{normal: [0, 0, 0]}]}]", "half-space normal"),
        (
            "objects: [{type: group, scale: [1, 0, 1], objects: [{type: sphere, material: water, radius: 1}]}]",
            "objects.0.scale.1 - input should be greater than 0, got 0",
        ),
        ("objects: [{type: box, material: water, size: [1, 0, 1]}]", "objects.0.size.1 - input should be greater than"),
    ],
)
def test_mistakes_are_one_sentence(text: str, words: str) -> None:
    with pytest.raises(SceneError) as caught:
        scan_of(text)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_planes_that_do_not_reach_a_member_of_a_group_are_left_out():
    members = ", ".join(f"{{type: sphere, material: water, radius: 1, center: [0, 0, {z}]}}" for z in (-9, 0, 9))
    scan = scan_of(f"objects: [{{type: group, objects: [{members}], clip: [{{normal: [0, 0, 1], offset: 0.5}}]}}]")
    below, cut = (shape for shape, _ in scan.scene.objects)
    assert [len(term) for term in below.terms] == [1]
    assert [len(term) for term in cut.terms] == [2]
    assert cut.contains(np.array([[0, 0, 0.4], [0, 0, 0.6]])).tolist() == [True, False]
