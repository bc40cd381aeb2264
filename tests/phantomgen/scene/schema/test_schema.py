"""Scene files: what they mean, and where the finger points when they are wrong."""

import json

import numpy as np
import pytest

from phantomgen.geometry.orbits import spread_angles
from phantomgen.scene.file.scene_file import SceneFile, preset_names, preset_summaries
from phantomgen.scene.scan import load_scene
from phantomgen.scene.schema import json_schema
from phantomgen.simulation.checks.field_of_view import coverage_warnings
from spectra.errors import SceneError

SCENE = """\
version: 1
name: toy
source: {type: monochromatic, energy: 60, photons: 1000}
detector: {type: photon_counting, thresholds: [20]}
geometry: {type: circular, sod: 100, sdd: 200, views: 4, test_views: 2}
panel: {rows: 6, columns: 8, pitch: 2}
volume: {voxels: 4, size: 20}
materials:
  water: {composition: H2O, density: 1.0}
  lead: {composition: Pb}
objects:
  - {type: sphere, material: water, radius: 5}
"""


def refusal(text: str, *overrides: str) -> str:
    with pytest.raises(SceneError) as caught:
        load_scene(SceneFile("toy.yaml", text, overrides))
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_a_scene_becomes_shapes_source_geometry_and_grid():
    scan = load_scene(SceneFile("toy.yaml", SCENE))
    assert scan.source.is_monochromatic
    assert [m.name for m in scan.scene.materials] == ["water"]
    assert scan.scene.objects[0][0].volume == pytest.approx(4 / 3 * np.pi * 125)
    assert (len(scan.geometry), scan.geometry.panel.columns, scan.geometry.panel.pitch) == (6, 8, (2.0, 2.0))
    assert scan.grid.spacing == (5.0, 5.0, 5.0)
    assert scan.scheme == "sparse4"


def test_training_views_come_first_and_test_views_lie_between():
    degrees = np.rad2deg(spread_angles(75, 100))
    assert degrees[:3] == pytest.approx([0.0, 4.8, 9.6])
    assert degrees[75:77] == pytest.approx([1.8, 5.4])
    scan = load_scene(SceneFile("toy.yaml", SCENE))
    assert scan.splits["train"].tolist() == [0, 1, 2, 3]
    assert scan.splits["test"].tolist() == [4, 5]


@pytest.mark.parametrize("name", ["kedge", "kedge-small"])
def test_presets_are_the_published_scene(name):
    scan = load_scene(name)
    assert scan.basis.names == ("photoelectric", "compton", "kedge_63.3")
    assert scan.detector.thresholds == (20.0, 45.0, 63.3, 80.0)
    volumes = [shape.volume for shape, _ in scan.scene.objects]
    assert volumes == pytest.approx([np.pi * r**2 * h for r, h in [(50, 100), (13, 80), (11, 80), (9, 80)]])
    assert scan.source.photons == pytest.approx(2e5)
    assert np.linalg.norm(scan.geometry.source, axis=1) == pytest.approx(500.0)
    assert scan.geometry.panel.columns * scan.geometry.panel.column_pitch == pytest.approx(204.8)
    assert scan.grid.shape[0] * scan.grid.spacing[0] == pytest.approx(128.0)
    # Source behind 2.5 mm Al: no photons below 20 keV to speak of, tungsten's K lines present.
    assert scan.source.line_energy.max() > 59


@pytest.mark.parametrize(
    ("name", "basis"),
    [
        ("contrast-vials", ("kedge_I", "kedge_Gd", "kedge_Au", "kedge_Bi")),
        ("multi-energy", ("kedge_I",)),
    ],
)
def test_presets_of_compositions_have_the_columns_and_thresholds_that_they_need(name, basis):
    scan = load_scene(name)
    assert scan.basis.names == ("photoelectric", "compton", *basis)
    assert len(scan.detector) > len(scan.basis)
    for edge in scan.basis.breaks:
        assert 0 < min(abs(np.array(scan.detector.thresholds) - edge)) < 0.1
    assert coverage_warnings(scan) == []
    shapes = [shape for shape, _ in scan.scene.objects]
    rods = np.array([shape.bounds for shape in shapes[1:]])
    centres, radius = rods.mean(axis=1)[:, :2], np.ptp(rods[0], axis=0)[0] / 2
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=-1)[~np.eye(len(centres), dtype=bool)]
    assert apart.min() > 2 * radius
    assert np.linalg.norm(centres, axis=1).max() + radius < shapes[0].bounds[1][0]


def test_presets_have_a_name_and_a_sentence():
    assert set(preset_names()) >= {"kedge", "kedge-small"}
    for name, summary in preset_summaries().items():
        assert SceneFile.preset(name).model.name == name
        assert summary.endswith(".")


def test_a_resolved_scene_is_the_same_scene():
    file = SceneFile.preset("kedge", ["geometry.views=9", "objects.1.radius=12.5"])
    again = SceneFile("again.yaml", file.resolved)
    assert again.model == file.model
    assert again.model.objects[1].radius == 12.5


def test_basis_functions_follow_from_the_materials():
    contrast = SCENE.replace("material: water", "material: contrast").replace(
        "  lead:", "  contrast: {composition: {H: 0.1, O: 0.8, I: 0.1}, density: 1.1}\n  lead:"
    )
    tube = contrast.replace("monochromatic, energy: 60", "tube, kvp: 80")
    assert load_scene(SceneFile("toy.yaml", tube)).basis.names == ("photoelectric", "compton", "kedge_I")
    # The threshold lies above iodine's edge, 33.17 keV: no channel sees it.
    assert load_scene(SceneFile("toy.yaml", tube.replace("[20]", "[40]"))).basis.names == ("photoelectric", "compton")


@pytest.mark.parametrize(
    "overrides",
    [
        ("objects.2.material=bone", "objects.3.material=bone"),
        ("materials.contrast_high.coefficients.kedge_63.3=0", "materials.contrast_low.coefficients.kedge_63.3=0"),
    ],
)
def test_a_k_edge_function_that_no_object_needs_is_left_out(overrides):
    one_energy = ("source={type: monochromatic, energy: 70, photons: 10}", "detector.thresholds=[20]")
    assert load_scene("kedge", (*one_energy, *overrides[:1])).basis.names[2:] == ("kedge_63.3",)
    assert load_scene("kedge", (*one_energy, *overrides)).basis.names == ("photoelectric", "compton")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("radius: 5", "radius: -5", "toy.yaml:12:45: objects.0.radius - input should be greater than 0, got -5"),
        ("radius: 5", "radus: 5", "toy.yaml:12:44: objects.0.radus - unknown key; did you mean 'radius'?"),
        ("radius: 5", "size: 5", "objects.0.size - unknown key"),
        ("radius: 5", "outer_radius: 5", "unknown key; did you mean 'radius'? (keys: material, center,"),
        ("voxels:", "spacing: 1, voxels:", "volume.spacing - unknown key: choose from voxels, size, slices, center"),
        (", radius: 5", "", "objects.0.radius - is missing"),
        ("material: water", "material: watr", "objects.0.material - unknown material 'watr'; did you mean 'water'?"),
        (
            "sphere",
            "blob",
            "objects.0.type - unknown type 'blob': choose from 'sphere', 'ellipsoid', 'cylinder', 'box'",
        ),
        ("type: sphere, ", "", "objects.0.type - is missing"),
        ("H2O", "Xx2O", "toy.yaml:9:10: materials.water - unknown material 'Xx2O'"),
        ("Pb}", "{Qq: 1.0}}", "materials.lead - unknown element 'Qq'"),
        ("Pb}", "{H: 0.5}}", "materials.lead - mass fractions must sum to 1"),
        ("H2O, density: 1.0", "H2O", "materials.water - material 'water' needs a density"),
        ("composition: Pb", "density: 2.0", "materials.lead - material 'lead' needs either"),
        ("[20]", "[20, 10]", "toy.yaml:4:47: detector.thresholds - thresholds must ascend"),
        ("[20]", "[20, 70]", "detector.thresholds - channel bin1 starts at 70 keV and sees no photons"),
        ("[20]", "[]", "detector.thresholds - "),
        ("sdd: 200", "sdd: 50", "toy.yaml:5:11: geometry - a circular orbit needs 0 < sod < sdd"),
        ("energy: 60", "energy: 6000", "source - the energy of a monochromatic source"),
        ("monochromatic, energy: 60", "tube, kvp: 900", "source - a tungsten tube works from 10 to 500 kV, got 900"),
        ("version: 1", "version: 2", "version - input should be 1, got 2"),
        ("name: toy", "name: a/b", "name - "),
        ("photons: 1000", "photons: .inf", "source.photons - "),
        ("photons: 1000", "photons: .nan", "source.photons - "),
        ("name: toy", "name: toy\nname: toy", "toy.yaml:3:1: the key 'name' stands twice in one mapping"),
        ("name: toy", "name: [toy", "toy.yaml:"),
        ("name: toy", "name: !!python/object:os.system {}", "toy.yaml:"),
    ],
)
def test_a_wrong_scene_is_refused_with_its_place(old, new, expected):
    assert old in SCENE
    assert expected in refusal(SCENE.replace(old, new, 1))


@pytest.mark.parametrize("text", ["", "[1, 2]", "just text", "\x00"])
def test_something_else_than_a_scene_is_refused(text):
    assert refusal(text).startswith("toy.yaml:1:")


def test_coefficients_outside_the_basis_are_refused():
    text = SceneFile.preset("kedge").text.replace(
        "contrast_low: {coefficients: {photoelectric", "contrast_low: {coefficients: {photoelectrc"
    )
    message = refusal(text)
    assert "materials.contrast_low.coefficients.photoelectrc" in message
    assert "did you mean 'photoelectric'?" in message


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("geometry.views=0", "--set geometry.views=0: geometry.views - input should be greater than 0, got 0"),
        ("geometry.vies=3", "--set geometry.vies=3: geometry.vies - unknown key; did you mean 'views'?"),
        ("geometri.views=3", "there is no 'geometri'; did you mean 'geometry'?"),
        ("objects.4.radius=3", "'4' is no entry of a list of 1"),
        ("objects.0.radius.x=3", "there is no key 'x' in a single value"),
        ("objects.0.radius=[", "is not a YAML value"),
        ("views", "write path=value"),
    ],
)
def test_a_wrong_override_is_named(override, expected):
    assert expected in refusal(SCENE, override)


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        (("objects.0.radius=3", "objects.0.radius="), "--set objects.0.radius=: objects.0.radius - input should be"),
        (("objects.0.axis=[0, 0, 0]",), "objects.0 (with --set objects.0.axis=[0, 0, 0]) - cylinder axis must not be"),
        (
            ("source.kvp=100", "detector.thresholds.1=10"),
            "detector.thresholds (with --set detector.thresholds.1=10) - ",
        ),
    ],
    ids=["last of two", "inside an object", "inside a list"],
)
def test_the_override_that_is_in_force_is_named(overrides, expected):
    with pytest.raises(SceneError) as error:
        load_scene("kedge-small", overrides)
    assert expected in str(error.value)


def test_overrides_reach_lists_mappings_and_new_keys():
    overrides = ["objects.0.radius=3", "materials.water.density=2", "seed=7", "detector.thresholds=[20, 40]"]
    model = SceneFile("toy.yaml", SCENE, tuple(overrides)).model
    assert (model.objects[0].radius, model.materials["water"].density, model.seed) == (3.0, 2.0, 7)
    assert model.detector.thresholds == (20.0, 40.0)


def test_unknown_presets_and_missing_files_are_refused(tmp_path):
    with pytest.raises(SceneError, match="neither a scene file nor a preset 'kegde'; did you mean kedge"):
        load_scene("kegde")
    with pytest.raises(SceneError, match="there is no scene file"):
        load_scene(tmp_path / "none.yaml")
    (tmp_path / "latin.yaml").write_bytes(b"name: \xff")
    with pytest.raises(SceneError, match="not UTF-8"):
        load_scene(tmp_path / "latin.yaml")


def test_the_json_schema_knows_every_shape():
    schema = json.dumps(json_schema())
    for word in ("sphere", "ellipsoid", "cylinder", "box", "tube", "photon_counting"):
        assert f'"{word}"' in schema
