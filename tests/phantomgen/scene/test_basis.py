"""Bases of materials in scene files and datasets."""

import numpy as np
import pytest

import phantomgen
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.validate import validate
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.forward_model.energy_grids import material_coefficients, material_fit
from recon.data.measurements import read_measurements
from spectra.errors import InputError, SceneError

SCENE = """\
version: 1
name: toy
source: {type: tube, kvp: 100, photons: 100000.0, filters: [{composition: Al, thickness: 2.5}]}
detector: {type: photon_counting, thresholds: [25, 33.2, 50, 65]}
geometry: {type: circular, sod: 100, sdd: 200, views: 4}
panel: {rows: 4, columns: 8, pitch: 4}
volume: {voxels: 4, size: 20}
basis:
  BASIS
materials:
  water: {composition: water}
  bone: {composition: "Bone, Cortical (ICRP)"}
  toy: {coefficients: {}}
  contrast: {solution: {solvent: water, solutes: {I: 20}}}
objects:
  - {type: sphere, material: water, radius: 8}
  - {type: sphere, material: contrast, radius: 4}
"""
MATERIALS = ("{type: material, material: water}", "{type: material, material: bone}", "{type: material, material: I}")
SVD = ("{type: svd, materials: [water, bone, I], count: 3}",)


def scene(*functions):
    return SceneFile("toy.yaml", SCENE.replace("BASIS", "\n  ".join(f"- {function}" for function in functions)))


def test_materials_of_the_scene_and_names_make_a_basis():
    scan = load_scene(scene(*MATERIALS))
    assert scan.basis.names == ("water", "bone", "I")
    coefficients = material_coefficients(scan)
    assert coefficients[0] == pytest.approx([0.0193, 0, 0], rel=1e-2, abs=1e-9)
    assert coefficients[1, 2] > 0
    assert (material_fit(scan).errors < 2e-3).all()


def test_a_mixture_may_be_a_basis_function():
    scan = load_scene(scene(*MATERIALS[:2], "{type: material, material: contrast}"))
    np.testing.assert_allclose(material_coefficients(scan)[1, :2], 0, atol=1e-9)


def test_singular_vectors_of_materials_make_a_basis():
    scan = load_scene(scene(*SVD))
    assert scan.basis.names == ("svd1", "svd2", "svd3")
    assert (material_fit(scan).errors < 2e-3).all()
    assert (material_coefficients(scan) < 0).any()


@pytest.mark.parametrize("functions", [MATERIALS, SVD], ids=["material", "svd"])
def test_a_dataset_gives_the_basis_back(tmp_path, functions):
    scan = load_scene(scene(*functions))
    path = tmp_path / "toy.h5"
    phantomgen.make(scan, path).close()
    assert validate(path) == []
    with open_dataset(path) as dataset:
        assert dataset.spectra.basis == scan.basis
        if functions == MATERIALS:
            assert read_measurements(dataset, dataset.splits["train"]).basis_names == ("water", "bone", "I")
        else:
            with pytest.raises(InputError, match="negative coefficients, which no fit here allows"):
                read_measurements(dataset, dataset.splits["train"])


@pytest.mark.parametrize(
    ("function", "words"),
    [
        ("{type: material, material: toy}", r"basis.0.material.*'toy' is given by coefficients"),
        ("{type: material, material: watr}", r"basis.0.material.*did you mean 'water'"),
        ("{type: material}", r"basis.0.*is missing"),
        ("{type: svd, materials: [water, bonne], count: 2}", r"basis.0.materials.1.*did you mean 'bone'"),
        ("{type: svd, materials: [water, bone], count: 3}", r"basis.0.*2 materials give 1 to 2 functions"),
        ("{type: svd, materials: [], count: 1}", r"basis.0.*materials"),
    ],
)
def test_errors_name_the_place(function, words):
    with pytest.raises(SceneError, match=words) as caught:
        load_scene(scene(function))
    assert str(caught.value).startswith("toy.yaml:9:")
    assert "\n" not in str(caught.value)
