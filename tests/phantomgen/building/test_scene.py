"""A scene in Python says what its scene file says, and refuses what the file refuses."""

from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import phantomgen
from phantomgen.building import shapes
from phantomgen.building.scene import Scene
from phantomgen.building.shapes import Described
from phantomgen.scene import schema
from phantomgen.scene.file.scene_file import SceneFile, preset_names
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.checks.verification import MeasuredError
from spectra import Material
from spectra.errors import InputError, SceneError

lengths = st.floats(0.5, 40, allow_nan=False)
places = st.tuples(*[st.floats(-30, 30, allow_nan=False)] * 3)
common = {"center": places, "material": st.sampled_from(["water", "bone", "Al"])}
turned = common | {"rotation": places}
PLAIN = {
    "Sphere": common | {"radius": lengths},
    "Ellipsoid": turned | {"radii": st.tuples(lengths, lengths, lengths)},
    "Cylinder": common | {"radius": lengths | st.tuples(lengths, lengths), "length": lengths},
    "Box": turned | {"size": st.tuples(lengths, lengths, lengths)},
    "Tube": common | {"radius": st.floats(10, 40), "inner_radius": st.floats(1, 9), "length": lengths},
    "Capsule": common | {"radius": lengths, "length": lengths},
    "Cone": common | {"radii": st.tuples(lengths, st.just(0.0) | lengths), "length": lengths},
    "Torus": common | {"radius": st.floats(10, 40), "tube": st.floats(1, 9)},
    "Polygon": turned | {"points": st.just(((0.0, 0.0), (9.0, 1.0), (3.0, 8.0))), "length": lengths},
    "Sweep": common | {"points": st.just(((0.0, 0.0, 0.0), (9.0, 0.0, 0.0), (20.0, 9.0, 0.0))), "radius": st.just(2.0)},
}
plain = st.one_of([st.builds(getattr(shapes, name), **keys) for name, keys in PLAIN.items() if name != "Sweep"])
bare = st.builds(shapes.Sphere, center=places, radius=lengths)
objects = st.one_of(
    plain,
    st.builds(shapes.Sweep, **PLAIN["Sweep"]),
    st.builds(shapes.Union, material=common["material"], shapes=st.tuples(bare, bare)),
    st.builds(shapes.Intersection, material=common["material"], shapes=st.tuples(bare, bare)),
    st.builds(shapes.Difference, material=common["material"], base=bare, cut=st.tuples(bare)),
    st.builds(shapes.Group, objects=st.tuples(plain, plain), rotation=places),
)
FIXED = {"panel": {"rows": 8, "columns": 8, "pitch": 20}, "volume": {"voxels": 8, "size": 100}}
ORBIT = {"type": "circular", "sod": 500, "sdd": 800, "views": 3}
BONE = {"bone": Material("bone", 1.9, {"Ca": 0.4, "P": 0.2, "O": 0.4})}


@settings(max_examples=30, deadline=None)
@given(st.lists(objects, min_size=1, max_size=4))
def test_a_scene_of_any_shapes_reads_back_equal_from_its_yaml(found):
    scene = Scene(objects=found, materials=BONE, geometry=ORBIT, **FIXED)
    again = Scene.from_yaml(scene.yaml)
    assert again == scene
    assert again.yaml == scene.yaml
    assert SceneFile("scene.yaml", scene.yaml).resolved == scene.file.resolved


@pytest.mark.parametrize("name", preset_names())
def test_presets_read_back_equal_from_their_yaml(name, tmp_path):
    scene = Scene.read(name)
    assert Scene.from_yaml(str(scene)) == scene
    assert Scene.read(scene.save(tmp_path / "copy.yaml")) == scene
    assert scene.file.resolved == SceneFile.preset(name).resolved


def test_every_type_of_object_has_a_class_with_its_keys():
    models = set(get_args(get_args(schema.ShapeModel)[0]))
    classes = [
        c for c in vars(shapes).values() if isinstance(c, type) and issubclass(c, Described) and c is not Described
    ]
    kinds = {c.model_fields["type"].default for c in classes}
    assert kinds == {kind for model in models for kind in get_args(model.model_fields["type"].annotation)}
    for found in classes:
        assert any(issubclass(found, model) and set(model.model_fields) == set(found.model_fields) for model in models)
        assert getattr(phantomgen, found.__name__) is found


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: shapes.Cylinder(radius=-1, length=3), "Cylinder: radius - input should be greater than 0, got -1"),
        (lambda: shapes.Cylinder(radius=1, lenght=3), "Cylinder: lenght - unknown key; did you mean 'length'"),
        (shapes.Sphere, "Sphere: radius - is missing"),
        (lambda: Scene(objects=[shapes.Sphere(radius=1, material="watr")]), "objects.0.material - .*mean 'water'"),
        (lambda: Scene(objects=[shapes.Sphere(radius=1)]), "objects.0.material - is missing"),
        (lambda: Scene(objects=[]), "objects - needs at least 1, got 0"),
        (lambda: Scene(objects=[shapes.Sphere(radius=1, material="water")], source={"kv": 9}), "source.kv - unknown"),
        (lambda: Scene.from_yaml("version: 1\nname: 3+\n"), "scene.yaml:"),
    ],
)
def test_what_a_scene_file_refuses_is_refused_with_its_key(make, words):
    with pytest.raises(SceneError, match=words):
        make()


@pytest.mark.parametrize("panel", [{"rows": 20, "columns": 50}, {"columns": 60}, {"pitch": 3.0}])
def test_a_panel_of_few_words_sees_all_of_the_objects(panel):
    scene = Scene(objects=[shapes.Cylinder(radius=200, length=100, material="water")], panel=panel)
    model = scene.file.model
    assert panel.items() <= scene.file.template["panel"].items()
    seen = np.abs(scene.scan.geometry.panel.pitch[1] * scene.scan.geometry.panel.columns / 2)
    assert seen > model.geometry.sdd * 200 / np.sqrt(model.geometry.sod**2 - 200**2)
    assert model.panel.rows * scene.scan.geometry.panel.pitch[0] / 2 > model.geometry.sdd * 50 / (
        model.geometry.sod - 200
    )


def test_orbit_panel_and_volume_fit_the_objects():
    scene = Scene(objects=[shapes.Cylinder(radius=200, length=100, material="water")])
    model = scene.file.model
    assert model.geometry.sod == 800
    assert model.volume.size == 440
    half = model.panel.pitch * model.panel.columns / 2
    assert half > model.geometry.sdd * 200 / np.sqrt(model.geometry.sod**2 - 200**2)
    assert half < 1.3 * model.geometry.sdd * 200 / np.sqrt(model.geometry.sod**2 - 200**2)


@pytest.mark.wrong_types
def test_line_integrals_are_chords_times_attenuation():
    scene = Scene(objects=[shapes.Sphere(radius=30, material="water"), shapes.Sphere(radius=10, material="Al")])
    starts, ends = np.array([[-90.0, 0, 0], [-90, 24, 0]]), np.array([[90.0, 0, 0], [90, 24, 0]])
    np.testing.assert_allclose(scene.path_lengths(starts, ends), [[40, 20], [36, 0]], atol=1e-9)
    water, aluminium = (Material(n, composition=n).attenuation(np.array([60.0]))[0] for n in ("water", "Al"))
    expected = [[40 * water + 20 * aluminium], [36 * water]]
    np.testing.assert_allclose(scene.line_integrals(starts, ends, 60), expected, rtol=1e-9)
    assert scene.line_integrals(starts, ends).shape == (2, 2)
    with pytest.raises(InputError, match="starts and ends of equal shape"):
        scene.path_lengths([[0, 0]], [[1, 1]])


def test_voxels_of_a_ball_hold_its_volume_on_any_grid():
    scene = Scene(objects=[shapes.Sphere(radius=20, material="water")])
    for grid in (None, phantomgen.Grid.cube(21, 50.0)):
        truth = scene.voxelize(grid)
        filled = truth.fractions.sum(dtype=np.float64) / 65535 * truth.grid.voxel_volume
        assert filled == pytest.approx(4 / 3 * np.pi * 20**3, rel=1e-3)


def test_dictionaries_change_a_scan_as_texts_do():
    values = {"geometry.views": 7, "source.filters": [{"composition": "Cu", "thickness": np.float64(1e-5)}]}
    texts = ["geometry.views=7", "source.filters=[{composition: Cu, thickness: 0.00001}]"]
    assert load_scene("kedge-small", values).text == load_scene("kedge-small", texts).text
    assert Scene.read("kedge-small").changed(values).file.model.geometry.views == 7
    with pytest.raises(SceneError, match=r"geometry\.views"):
        phantomgen.load("kedge-small", {"geometry.views": -1})


def test_a_scan_without_a_file_is_removed_when_closed_and_made_again_with_another_spectrum(monkeypatch):
    monkeypatch.setattr("phantomgen.simulation.run.quick_check", lambda *_: MeasuredError(0, 0, 0, 0, 0, 0, 0))
    scene = Scene(objects=[shapes.Sphere(radius=20, material="water")], geometry=ORBIT, **FIXED)
    softer = {"source.kvp": 90, "noise": False}
    with phantomgen.make(scene, keep_paths=True) as first, phantomgen.again(first, softer) as second:
        with phantomgen.make(scene.changed(softer)) as traced:
            np.testing.assert_allclose(second.load(), traced.load(), rtol=2e-3, atol=1)  # each errs by 1e-3
        assert second.load()[:, -1].sum() < 0.5 * first.load()[:, -1].sum()  # above 80 keV
        folders = [dataset.path.parent for dataset in (first, second, traced)]
        with pytest.raises(InputError, match="objects"):
            phantomgen.again(first, {"objects.0.radius": 10})
    assert not any(folder.exists() for folder in folders)


@pytest.mark.parametrize("package", ["phantomgen", "recon", "spectra", "recon.quality", "recon.figures"])
def test_a_package_lists_public_names_only(package):
    module = __import__(package, fromlist=["x"])
    assert sorted(dir(module)) == sorted(module.__all__)
    assert all(getattr(module, name) is not None for name in dir(module))
