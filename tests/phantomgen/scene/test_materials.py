"""Materials of a scene that are made of others."""

import numpy as np
import pytest

from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.materials import scene_materials
from phantomgen.scene.scan import load_scene
from spectra.errors import SceneError

SCENE = """\
version: 1
name: toy
source: {type: monochromatic, energy: 60, photons: 1000}
detector: {type: photon_counting, thresholds: [20]}
geometry: {type: circular, sod: 100, sdd: 200, views: 4}
panel: {rows: 6, columns: 8, pitch: 2}
volume: {voxels: 4, size: 20}
materials:
  MATERIAL
  tube: {composition: PMMA}
objects:
  - {type: sphere, material: tube, radius: 5}
"""


def materials(*lines: str):
    return scene_materials(SceneFile("toy.yaml", SCENE.replace("MATERIAL", "\n  ".join(lines))))


def refusal(*lines: str) -> str:
    with pytest.raises(SceneError) as caught:
        materials(*lines)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_parts_may_be_names_formulas_elements_and_materials_of_the_scene():
    made = materials(
        "contrast: {mixture: {by: volume, parts: {vessel: 0.9, 'Water, Liquid': 0.1}}}",
        "vessel: {solution: {solvent: blood, solutes: {I: 10, salt: 20}}}",
        "salt: {composition: GdCl3, density: 4.52}",
        "alloy: {mixture: {by: mass, parts: {C5H8O2: 0.8, BaSO4: 0.2}}, density: 1.4}",
    )
    vessel = 0.03 + (1 - 0.01 / 4.93 - 0.02 / 4.52) * 1.06
    assert made["vessel"].density == pytest.approx(vessel, rel=1e-12)
    assert made["contrast"].density == pytest.approx(0.9 * vessel + 0.1, rel=1e-12)
    assert made["contrast"].composition["I"] * made["contrast"].density == pytest.approx(0.009, rel=1e-12)
    assert made["alloy"].density == 1.4
    assert set(made) == {"contrast", "vessel", "salt", "alloy", "tube"}


def test_a_name_of_the_scene_goes_before_the_library():
    made = materials("blood: {composition: H2O, density: 1.0}", "half: {mixture: {by: mass, parts: {blood: 1}}}")
    assert made["half"].density == 1.0


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (
            ["a: {mixture: {by: mass, parts: {livr: 1}}}"],
            "toy.yaml:9:41: materials.a.mixture.parts.livr - unknown material 'livr'; did you mean 'liver'?",
        ),
        (
            ["agent: {composition: I}", "a: {solution: {solvent: water, solutes: {agnt: 1}}}"],
            "toy.yaml:10:50: materials.a.solution.solutes.agnt - unknown material 'agnt'; did you mean 'agent'?",
        ),
        (
            ["a: {solution: {solvent: wodka, solutes: {I: 1}}}"],
            "toy.yaml:9:27: materials.a.solution.solvent - unknown material 'wodka'",
        ),
        (
            ["a: {mixture: {by: mass, parts: {a: 1}}}"],
            "toy.yaml:9:38: materials.a.mixture.parts.a - material 'a' contains itself (a -> a)",
        ),
        (
            [
                "a: {mixture: {by: mass, parts: {b: 1}}}",
                "b: {solution: {solvent: c, solutes: {I: 1}}}",
                "c: {mixture: {by: volume, parts: {a: 1}}}",
            ],
            "toy.yaml:11:40: materials.c.mixture.parts.a - material 'a' contains itself (a -> b -> c -> a)",
        ),
        (
            ["a: {mixture: {by: mass, parts: {water: 0.5, liver: 0.4}}}"],
            "toy.yaml:9:6: materials.a - the mass fractions of 'a' must sum to 1, they sum to 0.9",
        ),
        (
            ["a: {mixture: {by: volume, parts: {H2SO4: 0.5, water: 0.5}}}"],
            "toy.yaml:9:6: materials.a - 'H2SO4' needs a density to be mixed: make it a material with one",
        ),
        (
            ["t: {coefficients: {compton: 0.02}}", "a: {mixture: {by: volume, parts: {t: 1}}}"],
            "toy.yaml:10:40: materials.a.mixture.parts.t - 't' is given by coefficients: only compositions",
        ),
        (
            ["a: {solution: {solvent: water, solutes: {I: -1}}}"],
            "toy.yaml:9:47: materials.a.solution.solutes.I - input should be greater than or equal to 0, got -1",
        ),
        (["a: {mixture: {by: weight, parts: {water: 1}}}"], "materials.a.mixture.by - input should be 'mass' or"),
        (["a: {mixture: {by: mass, parts: {}}}"], "materials.a.mixture.parts - "),
        (["a: {mixture: {by: mass, part: {}}}"], "materials.a.mixture.part - unknown key; did you mean 'parts'?"),
        (
            ["a: {composition: water, solution: {solvent: water, solutes: {I: 1}}}"],
            "toy.yaml:9:6: materials.a - material 'a' needs either a composition, coefficients, a mixture, a",
        ),
        (["a: {composition: CO, density: 8}"], "toy.yaml:9:6: materials.a - CO in 'CO' may mean Co"),
    ],
)
def test_impossible_materials_are_refused_with_their_place(lines, expected):
    assert expected in refusal(*lines)


def test_a_resolved_scene_keeps_the_recipe():
    text = SCENE.replace("MATERIAL", "vial: {solution: {solvent: water, solutes: {I: 10}}}")
    file = SceneFile("toy.yaml", text, ("materials.vial.solution.solutes.I=5",))
    again = SceneFile("again.yaml", file.resolved)
    assert again.model == file.model
    vial = scene_materials(again)["vial"]
    assert vial.composition["I"] * vial.density == pytest.approx(0.005)


def test_filters_and_sensors_may_be_named():
    text = SCENE.replace("MATERIAL", "w: {composition: water}").replace(
        "thresholds: [20]", "thresholds: [20], composition: CZT"
    )
    assert load_scene(SceneFile("toy.yaml", text)).detector.absorption(np.array([60.0])) > 0.9


def of_object(name: str) -> SceneFile:
    return SceneFile(
        "toy.yaml", SCENE.replace("MATERIAL", "tissue: {composition: PMMA}").replace(": tube,", f": {name},")
    )


@pytest.mark.parametrize(("name", "density"), [("Al", 2.6941), ("blood", 1.06)])
def test_objects_take_elements_and_known_names_as_filters_do(name, density):
    (material,) = load_scene(of_object(name)).scene.materials
    assert (material.name, material.composition) == (name, name)
    assert material.density == pytest.approx(density, rel=0.01)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("tissu", "9:30: objects.0.material - unknown material 'tissu'; did you mean 'tissue'?"),
        ("watr", "unknown material 'watr'; did you mean 'water'?"),
        ("Gd2O3", "material 'Gd2O3' needs a density"),
    ],
)
def test_an_unknown_material_of_an_object_is_one_sentence(name, said):
    with pytest.raises(SceneError) as error:
        load_scene(of_object(name))
    assert said.removeprefix("9:30: ") in str(error.value)
