"""Objects where source or panel are."""

import pytest

from phantomgen.scene.file.scene_file import SceneFile, preset_names
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.checks.collisions import check_collisions
from phantomgen.simulation.run import simulate
from spectra.errors import GeometryError

SCENE = """\
version: 1
name: toy
source: {type: monochromatic, energy: 60, photons: 1.0e4}
detector: {type: photon_counting, thresholds: [20]}
geometry: {type: circular, sod: 100, sdd: 200, views: 8}
panel: {rows: 10, columns: 10, pitch: 4}
volume: {voxels: 6, size: 20}
materials:
  water: {composition: H2O, density: 1.0}
objects:
  - {type: sphere, material: water, radius: 5}
  - {type: sphere, material: water, radius: 5, center: [0, 0, 0]}
"""
FAR_ALONG = "geometry={type: parallel, distance: %s, views: 4}"


def toy(*overrides):
    return load_scene(SceneFile("toy.yaml", SCENE, overrides))


def refusal(scan):
    """The sentence that refuses a scan; empty where none does."""
    try:
        check_collisions(scan)
    except GeometryError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (
            ["objects.1.center=[98, 0, 0]"],
            r"object 1 \(water\) reaches (2\.9|3) mm behind the panel in view 4, and in 12%",
        ),
        (["objects.1.center=[-110, 0, 0]", "geometry.views=1"], "reaches 15 mm behind the panel in view 0"),
        (["objects.1.center=[110, 3, 0]"], r"object 1 \(water\) lies behind the source in view 0, by 5 mm"),
        ([FAR_ALONG % 4], "object 0 .* reaches 1 mm behind the panel in view"),
        (
            ["objects.1={type: box, material: water, size: [100, 10, 10], center: [-100, 0, 0]}"],
            "50 mm behind the panel",
        ),
        (["geometry.sdd=103"], "object 0 .* reaches 2 mm behind the panel"),
    ],
)
def test_an_object_in_the_place_of_panel_or_source_is_refused_before_any_work(overrides, words, tmp_path):
    with pytest.raises(GeometryError, match=words):
        simulate(toy(*overrides), tmp_path / "a.h5")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "overrides",
    [
        [],
        ["objects.1={type: box, material: water, size: [900, 900, 900]}"],  # air around everything
        ["objects.1={type: box, material: water, size: [900, 10, 10], center: [0, 0, 120]}"],  # beside the panel
        ["objects.1.center=[0, 0, 60]"],
        ["objects.1.radius=99.9", "geometry.sdd=201"],
        [FAR_ALONG % 5.1],
        ["background=water"],
    ],
)
def test_what_rays_do_not_meet_behind_the_panel_may_be_there(overrides):
    assert refusal(toy(*overrides)) == ""


@pytest.mark.parametrize("name", [name for name in preset_names() if name not in {"foam", "random"}])
def test_presets_have_possible_geometries(name):
    time = ["time.phases=null"] if SceneFile.preset(name).model.time else []
    assert refusal(load_scene(name, ["geometry.views=5", "geometry.test_views=0", *time])) == ""
