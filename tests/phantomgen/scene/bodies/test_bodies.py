"""Bodies: objects in their places, lengths that do not depend on the size, and one sentence for what is wrong."""

import numpy as np
import pytest

import phantomgen
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.scene.bodies.additions import Places
from phantomgen.scene.bodies.head import PLACES as HEAD
from phantomgen.scene.bodies.torso import PLACES as TORSO
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from spectra.errors import SceneError

SCENE = """\
version: 1
name: body
source: {{type: tube, kvp: 120, photons: 1000}}
detector: {{type: photon_counting, thresholds: [25, 60]}}
geometry: {{type: circular, sod: 600, sdd: 1000, views: 3}}
panel: {{rows: 8, columns: 16, pitch: 40}}
volume: {{voxels: 4, size: 440}}
time: {{duration: 5, signals: {{breath: {{type: respiratory, period: 4}}, beat: {{type: cardiac, period: 1}}}}}}
objects:
  - {{{keys}}}
"""


def body(keys, *overrides):
    return load_scene(SceneFile("body.yaml", SCENE.format(keys=keys), overrides))


def material_at(scan, *place, scale=1.0):
    """Name of the material in a small voxel, which it fills."""
    x, y, z = (scale * c for c in place)
    parts = scan.scene.fractions(Grid((1, 1, 1), (0.2, 0.2, 0.2), (z, y, x)))[:, 0, 0, 0]
    assert parts.max() == pytest.approx(1.0, abs=1e-6)
    return scan.scene.materials[int(parts.argmax())].name


@pytest.mark.parametrize(("size", "sex", "scale"), [(1.0, "male", 1.0), (0.7, "female", 0.644)])
def test_organs_of_a_torso_lie_in_their_places(size, sex, scale):
    scan = body(f"type: torso, sex: {sex}, size: {size}, contrast: {{phase: arterial}}")
    found = {
        name: material_at(scan, *place, scale=scale)
        for name, place in {
            "right lung": (-78, -20, 20),
            "left lung": (85, 20, 50),
            "descending aorta": (19, 42, 20),
            "left ventricle": (32, -18, -4),
            "liver": (-75, -10, -110),
            "kidney": (-72, 48, -165),
            "vertebra": (0, 68, -1),
            "windpipe": (0, 30, 140),
            "stomach gas": (58, -48, -112),
        }.items()
    }
    assert found == {
        "right lung": "inflated lung",
        "left lung": "inflated lung",
        "descending aorta": "arteries, arterial phase",
        "left ventricle": "arteries, arterial phase",
        "liver": "liver, arterial phase",
        "kidney": "kidney, arterial phase",
        "vertebra": "spongiosa",
        "windpipe": "air",
        "stomach gas": "air",
    }


def test_organs_of_a_head_lie_in_their_places():
    scan = body("type: head, crowns: gold")
    assert material_at(scan, 30, 10, 60) == "brain"
    assert material_at(scan, 0, 6, 108) == "cranium"
    assert material_at(scan, 33, -74, -6) == "water"
    assert material_at(scan, -33, -85.5, -6) == "eye lens"
    assert material_at(scan, 0, 22, -94) == "spongiosa"
    assert {"gold alloy", "enamel"} <= {material.name for material in scan.scene.materials}
    assert "gold alloy" not in {material.name for material in body("type: head").scene.materials}


@pytest.mark.parametrize("size", [0.7, 1.2])
def test_fat_and_lesions_have_the_size_that_is_stated(size):
    def width(fat):
        scan = body(f"type: torso, size: {size}, fat: {fat}")
        lengths = scan.scene.path_lengths(np.array([[-500.0, 0.0, -0.01]]), np.array([[1000.0, 0.0, 0.0]]))
        return lengths.sum()

    assert width(30) - width(10) == pytest.approx(40, abs=1e-3)
    scan = body(f"type: torso, size: {size}, lesion: {{organ: liver, diameter: 14, material: Fe}}")
    x, y, z = (size * c for c in TORSO.organs["liver"][0])
    filled = scan.scene.fractions(Grid((20, 20, 20), (1.0, 1.0, 1.0), (z - 9.5, y - 9.5, x - 9.5)))
    iron = [material.name for material in scan.scene.materials].index("Fe")
    assert filled[iron].sum() == pytest.approx(np.pi * 14**3 / 6, rel=1e-4)


@pytest.mark.parametrize(("kind", "places"), [("torso", TORSO), ("head", HEAD)])
def test_all_that_may_be_added_lies_in_the_body(kind, places: Places):
    for organ, (center, _) in places.organs.items():
        sex, scale = ("female", 0.92) if organ == "breast" else ("male", 1.0)
        whole = body(f"type: {kind}, sex: {sex}")
        inside = whole.scene.path_lengths(scale * np.array([center]), np.array([[1.0, 0.0, 0.0]]))
        assert inside.sum() == pytest.approx(1.0)
        scan = body(f"type: {kind}, sex: {sex}, lesion: {{organ: {organ}, material: Ti}}")
        assert material_at(scan, *center, scale=scale) == "Ti"
    for vessel, (center, _, _) in places.vessels.items():
        keys = f"{{vessel: {vessel}}}"
        plaque = f"{{vessel: {vessel}, diameter: 2}}"
        scan = body(f"type: {kind}, contrast: {{phase: portal}}, stent: {keys}, calcification: {plaque}")
        assert {"Fe", "plaque"} <= {material.name for material in scan.scene.materials}
        assert material_at(scan, *center) == "arteries, portal phase"


def test_bodies_may_be_random_and_move():
    keys = "type: torso, sex: {choice: [female, male]}, size: {uniform: [0.8, 1.1]}, fat: {uniform: [5, 40]}"
    moving = ", arms: {choice: [up, down]}, respiration: breath, heartbeat: beat"
    first, again, other = (body(keys + moving, f"seed={seed}") for seed in (1, 1, 2))
    assert first.text == again.text
    assert first.text.replace("seed: 1", "seed: 2") != other.text
    assert first.dynamics is not None
    assert first.dynamics.at(first.scene, 2.0).solids.locals_.tolist() != first.scene.solids.locals_.tolist()


def test_the_stored_scene_has_plain_objects_and_reads_back_equal():
    scan = body("type: head, center: [1, 2, 3], rotation: [0, 0, 10], contrast: {phase: late, element: Gd}")
    assert "type: head" not in scan.text
    again = load_scene(SceneFile("stored.yaml", scan.text))
    assert again.text == scan.text
    assert np.array_equal(again.scene.solids.locals_, scan.scene.solids.locals_)


def test_a_material_of_the_scene_takes_the_place_of_one_of_the_body():
    scan = body("type: torso", "materials={inflated lung: {composition: H2O, density: 0.5}}")
    lung = next(m for m in scan.scene.materials if m.name == "inflated lung")
    assert (lung.composition, lung.density) == ("H2O", 0.5)


def test_bodies_in_groups_and_in_python_are_the_same():
    one = body("type: group, center: [0, 0, 5], objects: [{type: head, fat: 6}]")
    scene = phantomgen.Scene(objects=[phantomgen.Group(center=(0, 0, 5), objects=[phantomgen.Head(fat=6)])])
    np.testing.assert_array_equal(one.scene.solids.locals_, scene.scan.scene.solids.locals_)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ("type: torso, size: 2", "objects.0.size - input should be less than or equal to 1.3, got 2"),
        ("type: torso, lesion: {organ: livr}", "lesion.organ 'livr' is not known: did you mean 'liver'?"),
        ("type: head, stent: {vessel: aorta}", "stent.vessel 'aorta' is not known: there are carotid"),
        ("type: head, material: water", "a body has tissues, and no material of its own"),
        ("type: torso, lesion: {organ: breast}", "a lesion of the breast needs 'sex: female'"),
        ("type: torso, faat: 3", "objects.0.faat - unknown key; did you mean 'fat'"),
        ("type: torso, respiration: breth", "there is no signal 'breth'; did you mean 'breath'?"),
        ("type: torso, contrast: {phase: venous}", "objects.0.contrast.phase"),
        ("type: torsoo", "unknown type 'torsoo'"),
    ],
)
def test_impossible_bodies_are_refused(keys, words):
    with pytest.raises(SceneError) as caught:
        body(keys)
    assert words in str(caught.value)
    assert "body.yaml:" in str(caught.value)
