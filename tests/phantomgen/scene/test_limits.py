"""Scenes that would hang or fill memory are one sentence."""

import pytest

from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from spectra.errors import SceneError

SCENE = """\
version: 1
name: toy
source: {type: monochromatic, energy: 60, photons: 1000}
detector: {type: photon_counting, thresholds: [20]}
geometry: {type: circular, sod: 100, sdd: 200, views: 12}
panel: {rows: 12, columns: 16, pitch: 2}
volume: {voxels: 12, size: 20}
effects: {blur: {fwhm: 1}}
materials: {water: {composition: H2O, density: 1.0}}
objects: [{type: sphere, material: water, radius: 5}]
"""
MANY = "{type: grid, count: [99999, 99999, 99999], step: [1, 1, 1]}"
FEW = "{type: grid, count: [1, 1, 99999], step: [1, 1, 1]}"
BALL = "{type: sphere, material: water, radius: 1}"


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("geometry.views=90000000", "geometry.views - input should be less than or equal to 1000000"),
        ("geometry.sdd=1e9", "geometry.sdd - input should be less than or equal to"),
        ("volume.size=1e300", "volume.size - input should be less than or equal to"),
        ("volume.voxels=1000000", "volume.voxels - input should be less than or equal to 8192"),
        ("panel.rows=10000000000", "panel.rows - input should be less than or equal to"),
        ("effects.blur.fwhm=1e300", "effects.blur.fwhm - input should be less than or equal to"),
        ("effects.blur.fwhm=1e6", "effects.blur.fwhm - input should be less than or equal to"),
        ("flats=1000000000", "flats - input should be less than or equal to"),
        ("objects.0.count=1000000000", "count - must be at most 1000000, got 1000000000"),
        (f"objects.0.repeat={{type: ring, count: {10**30}}}", "count - input should be less than or equal to 100000"),
        (f"objects.0.repeat={MANY}", "has more than 1000000 objects"),
        (
            f"objects=[{{type: union, material: water, shapes: [{{type: sphere, radius: 1, repeat: {MANY}}}]}}]",
            "has more",
        ),
        (
            f"objects=[{{type: group, repeat: {FEW}, objects: [{{type: group, repeat: {FEW}, objects: [{BALL}]}}]}}]",
            "has more",
        ),
        ("materials.water.composition=H99999999999999999999", "atoms of one kind"),
        ("name=!!int abc", "is not a YAML value"),
    ],
)
def test_numbers_beyond_any_scan_are_refused(override, words):
    with pytest.raises(SceneError, match=words):
        load_scene(SceneFile("toy.yaml", SCENE, (override,)))


def test_messages_shorten_long_input():
    with pytest.raises(SceneError) as caught:
        load_scene(SceneFile("toy.yaml", SCENE, (f"name={'?' * 5000}",)))
    assert len(str(caught.value)) < 400
    with pytest.raises(SceneError) as caught:
        load_scene(SceneFile("toy.yaml", SCENE.replace("name: toy", f"name: '{'?' * 5000}'")))
    assert len(str(caught.value)) < 300
