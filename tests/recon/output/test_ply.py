"""Gaussians as splats: what plyfile reads is what the model says, in the properties that viewers of splats look for."""

import json
from dataclasses import replace

import h5py
import nibabel
import numpy as np
import pytest
import pyvista
import torch
from click.testing import CliRunner
from plyfile import PlyData
from support.gaussian_scenes import small_model
from support.tiny_scans import one_sentence

from phantomgen.geometry.voxel_grid import Grid
from recon.cli.main import main as recon
from recon.figures.basis_colours import basis_colours, mixed_colours
from recon.gaussians.model import Gaussians
from recon.output.ply import HARMONIC, opacities, write_ply
from recon.runs.read_run import read_run
from recon.runs.write_run import write_volumes
from spectra.errors import DatasetError

NAMES = ("photoelectric", "compton", "kedge_63.3")
GRID = Grid((5, 6, 7), (2.0, 1.5, 1.0), (-4.0, -3.75, -3.0))


@pytest.fixture(scope="module")
def model():
    return replace(small_model(1), basis_names=NAMES)


@pytest.fixture
def run(model, tmp_path):
    """A run folder, without what nobody here reads."""
    folder = tmp_path / "run"
    folder.mkdir()
    model.save(folder / "model.safetensors")
    write_volumes(folder / "volumes.h5", model.volume(GRID), NAMES, GRID, {})
    (folder / "metrics.json").write_text('{"dataset": "/somewhere/scan.h5"}')
    return folder


def command(*arguments):
    return CliRunner().invoke(recon, ["export", *map(str, arguments)])


def test_splats_have_the_numbers_of_the_model(model, tmp_path):
    write_ply(tmp_path / "m.ply", model)
    file = PlyData.read(tmp_path / "m.ply")
    vertex = file["vertex"]
    names = [p.name for p in vertex.properties]
    assert " ".join(names[:10]) == "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2 opacity"
    assert {str(p.val_dtype) for p in vertex.properties} == {"f4"}

    def columns(*keys):
        return np.stack([vertex[key] for key in keys], axis=1)

    np.testing.assert_allclose(columns("x", "y", "z"), model.centres, rtol=1e-6)
    np.testing.assert_allclose(columns("scale_0", "scale_1", "scale_2"), model.log_scales, rtol=1e-6)
    turns = columns("rot_0", "rot_1", "rot_2", "rot_3")
    np.testing.assert_allclose(np.linalg.norm(turns, axis=1), 1, rtol=1e-6)
    np.testing.assert_allclose(turns, torch.nn.functional.normalize(model.quaternions), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(columns("basis_0", "basis_1", "basis_2"), model.coefficients, rtol=1e-6)
    colours = columns("f_dc_0", "f_dc_1", "f_dc_2") * HARMONIC + 0.5
    np.testing.assert_allclose(colours, mixed_colours(model.coefficients.numpy(), NAMES), atol=1e-6)
    opacity = 1 / (1 + np.exp(-vertex["opacity"].astype(float)))
    np.testing.assert_allclose(opacity, opacities(model.coefficients.numpy(), model.log_scales.numpy()), atol=1e-6)
    assert "mm" in file.comments[0]
    assert "basis_2 kedge_63.3 1/mm" in file.comments[1]


def test_splats_in_a_row_let_through_what_the_model_does():
    """A line of round Gaussians, looked at along it: blending multiplies, line integrals add."""
    count, sigma, along = 40, 1.3, torch.arange(40) * 2.0 - 39.0
    centres = torch.stack([torch.zeros(count), torch.zeros(count), along], dim=1)
    turns = torch.tensor([[1.0, 0, 0, 0]]).expand(count, 4)
    coefficients = torch.tensor([[0.002, 0.02, 0.01]]).expand(count, 3)
    model = Gaussians(centres, torch.full((count, 3), sigma).log(), turns, coefficients, NAMES)
    fine = Grid((4000, 1, 1), (0.05, 1e-3, 1e-3), (-99.975, 0.0, 0.0))
    path = model.volume(fine).sum() * 0.05
    through = np.prod(1 - opacities(coefficients.numpy(), model.log_scales.numpy()))
    assert through == pytest.approx(np.exp(-path), rel=1e-3)


def test_opacity_stays_between_0_and_1():
    found = opacities(np.array([[0.0, 0.0], [0.01, 0.02], [9.0, 9.0]]), np.zeros((3, 3)))
    assert found == pytest.approx([1e-4, 1 - np.exp(-np.sqrt(2 * np.pi) * 0.03), 0.99])


def test_a_colour_is_that_of_the_basis_that_tells_most():
    tissue, bone, contrast = np.array([0.0, 1, 0]), np.array([1.0, 1, 0]), np.array([1.0, 1, 1])
    painted = mixed_colours(np.stack([tissue, bone, contrast]), NAMES)
    wanted = [basis_colours(NAMES)[i] for i in (1, 0, 2)]
    assert ["#" + bytes(np.rint(255 * c).astype(np.uint8)).hex().upper() for c in painted] == wanted
    shuffled = mixed_colours(np.stack([tissue, bone, contrast])[:, [2, 0, 1]], (NAMES[2], NAMES[0], NAMES[1]))
    np.testing.assert_allclose(shuffled, painted)
    assert len(set(basis_colours(("compton", "photoelectric", "kedge_Gd", "kedge_I", "kedge_Au")))) == 5


def test_a_basis_without_coefficients_has_no_colour():
    empty = mixed_colours(np.array([[0.0, 0.5, 0.0], [0.0, 1.0, 0.0]]), NAMES)
    assert np.isfinite(empty).all()
    assert np.array_equal(empty[0], empty[1])


def test_a_model_without_gaussians_is_a_file_without_splats(model, tmp_path):
    parts = (model.centres, model.log_scales, model.quaternions, model.coefficients)
    write_ply(tmp_path / "none.ply", Gaussians(*(part[:0] for part in parts), NAMES))
    assert PlyData.read(tmp_path / "none.ply")["vertex"].count == 0


def test_a_run_is_exported_in_every_format(run, model, tmp_path):
    for name in ("a.vti", "a.nii.gz", "a.ply"):
        result = command(run, "-o", tmp_path / name)
        assert (result.exit_code, result.stderr) == (0, ""), result.output
    volumes = model.volume(GRID)
    image = pyvista.read(tmp_path / "a.vti")
    assert image.origin == (-3.0, -3.75, -4.0)
    assert np.array_equal(image.point_data["compton"].reshape(GRID.shape), volumes[1])
    assert np.array_equal(np.asarray(nibabel.load(tmp_path / "a.nii.gz").dataobj), volumes.T)
    assert PlyData.read(tmp_path / "a.ply")["vertex"].count == len(model)
    found = json.loads(command(run, "-o", tmp_path / "a.ply", "--overwrite", "--json").stdout)
    assert found == {"file": str(tmp_path / "a.ply"), "gaussians": len(model), "bases": list(NAMES)}


def test_a_run_in_voxels_has_volumes_but_no_splats(run, tmp_path):
    (run / "model.safetensors").unlink()
    assert command(run, "-o", tmp_path / "a.nii").exit_code == 0
    assert "without Gaussians" in one_sentence(command(run, "-o", tmp_path / "a.ply"))
    assert not (tmp_path / "a.ply").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("a.obj",), "one of .vti, .nii, .nii.gz, .ply"),
        (("nowhere/a.ply",), "does not exist"),
        (("mine.vti",), "add --overwrite"),
    ],
)
def test_outputs_that_cannot_be_are_one_sentence(run, arguments, words, tmp_path):
    (tmp_path / "mine.vti").write_text("mine")
    assert words in one_sentence(command(run, "-o", tmp_path / arguments[0]))
    assert (tmp_path / "mine.vti").read_text() == "mine"


def test_a_missing_package_is_one_sentence_that_names_the_extra(run, tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "plyfile", None)
    assert "pip install 'spectral-ct[io]'" in one_sentence(command(run, "-o", tmp_path / "a.ply"))


def test_a_stored_run_has_what_was_written(run, model):
    stored = read_run(run)
    assert (stored.name, stored.dataset, stored.grid, stored.basis_names) == ("run", "scan.h5", GRID, NAMES)
    assert np.array_equal(stored.volumes, model.volume(GRID))
    shifted = Grid(GRID.shape, GRID.spacing, (-3.0, -3.75, -3.0))
    np.testing.assert_array_equal(stored.on(shifted), model.volume(shifted))
    (run / "model.safetensors").unlink()
    halfway = read_run(run).on(shifted)
    np.testing.assert_allclose(halfway[:, 0], (stored.volumes[:, 0] + stored.volumes[:, 1]) / 2, atol=1e-6)


def test_folders_that_are_no_runs_are_one_sentence(run, tmp_path):
    with pytest.raises(DatasetError, match="there is no run folder"):
        read_run(tmp_path / "none")
    with pytest.raises(DatasetError, match=r"has neither volumes.h5 nor model.safetensors; make one by recon fit"):
        read_run(tmp_path)
    with h5py.File(run / "volumes.h5", "a") as file:
        del file["grid/origin"]
    with pytest.raises(DatasetError, match=r"volumes.h5 lacks /grid/origin"):
        read_run(run)
    (run / "volumes.h5").write_bytes(b"nonsense")
    with pytest.raises(DatasetError, match=r"volumes.h5 cannot be read as what recon fit writes there"):
        read_run(run)


def test_a_model_of_another_version_or_another_run_is_refused(run, model, monkeypatch):
    replace(model, basis_names=("photoelectric", "compton", "kedge_50.2")).save(run / "model.safetensors")
    with pytest.raises(DatasetError, match="they are not of one run"):
        read_run(run)
    with monkeypatch.context() as patch:
        patch.setattr(Gaussians, "SCHEMA", "spectral-ct gaussians 9.0")
        model.save(run / "model.safetensors")
    with pytest.raises(DatasetError, match=r"written as 'spectral-ct gaussians 9.0', this version reads"):
        read_run(run)
