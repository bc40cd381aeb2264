"""Exported volumes, opened by the programs they are for: the same numbers at the same millimetres."""

import builtins
import re

import nibabel
import numpy as np
import pytest
import pyvista
import SimpleITK
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from support.tiny_scans import make, one_sentence

from phantomgen.cli.main import main as phantomgen
from phantomgen.dataset.truth import read_truth
from phantomgen.exporters.volumes import Volumes, basis_volumes, suffix_of, write_volumes
from phantomgen.geometry.voxel_grid import Grid
from spectra.errors import InputError, NotInstalledError, StorageError

GRID = Grid((3, 4, 5), (2.0, 1.5, 0.5), (-7.0, 3.0, 11.0))
NAMES = ("photoelectric", "compton")
VALUES = np.random.default_rng(0).normal(size=(2, *GRID.shape)).astype(np.float32)
VOLUMES = basis_volumes(GRID, NAMES, VALUES)


def place(z, y, x):
    """Centre of a voxel (x, y, z) [mm], written out."""
    return 11.0 + 0.5 * x, 3.0 + 1.5 * y, -7.0 + 2.0 * z


@pytest.mark.parametrize("index", [(0, 0, 0), (2, 0, 1), (1, 3, 4)])
def test_vti_has_every_value_at_its_millimetres(index, tmp_path):
    write_volumes(tmp_path / "v.vti", VOLUMES)
    image = pyvista.read(tmp_path / "v.vti")
    point = image.find_closest_point(place(*index))
    assert image.points[point] == pytest.approx(place(*index))
    for name, values in zip(NAMES, VALUES, strict=True):
        assert image.point_data[name].dtype == np.float32
        assert image.point_data[name][point] == values[index]
    assert list(image.field_data["about"]) == ["basis coefficients [1/mm]: photoelectric, compton"]


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".NII.GZ"])
@pytest.mark.parametrize("index", [(0, 0, 0), (2, 0, 1), (1, 3, 4)])
def test_nifti_has_every_value_at_its_millimetres(suffix, index, tmp_path):
    write_volumes(tmp_path / f"v{suffix}", VOLUMES)
    image = nibabel.load(tmp_path / f"v{suffix}")
    z, y, x = index
    for affine in (image.affine, image.header.get_qform()):
        assert (affine @ [x, y, z, 1])[:3] == pytest.approx(place(*index))
    assert image.dataobj[x, y, z].tolist() == VALUES[:, z, y, x].tolist()
    assert nibabel.aff2axcodes(image.affine) == ("R", "A", "S")
    assert image.header.get_xyzt_units()[0] == "mm"
    assert image.header.extensions[0].get_content().startswith(b"basis coefficients [1/mm]")


def test_itk_shows_x_and_y_of_the_same_points_with_the_opposite_sign(tmp_path):
    write_volumes(tmp_path / "v.nii", Volumes(GRID, {"compton": VALUES[1]}, "test"))
    image = SimpleITK.ReadImage(str(tmp_path / "v.nii"))
    x, y, z = place(2, 0, 1)
    assert image.TransformIndexToPhysicalPoint((1, 0, 2)) == pytest.approx((-x, -y, z))
    assert np.array_equal(SimpleITK.GetArrayFromImage(image), VALUES[1])


@given(
    shape=st.tuples(*[st.integers(1, 4)] * 3),
    spacing=st.tuples(*[st.floats(0.01, 50)] * 3),
    origin=st.tuples(*[st.floats(-300, 300)] * 3),
)
def test_the_place_of_any_grid_comes_back(shape, spacing, origin, tmp_path_factory):
    grid, folder = Grid(shape, spacing, origin), tmp_path_factory.mktemp("grid")
    volumes = Volumes(grid, {"a": np.ones(shape, np.float32)}, "ones")
    for name in ("v.vti", "v.nii"):
        write_volumes(folder / name, volumes)
    image = pyvista.read(folder / "v.vti")
    assert image.dimensions == shape[::-1]
    assert image.spacing == pytest.approx(spacing[::-1])
    assert image.origin == pytest.approx(origin[::-1])
    assert nibabel.load(folder / "v.nii").affine == pytest.approx(grid.affine, rel=1e-6, abs=1e-5)  # float32 there


def test_an_unknown_suffix_lists_those_known(tmp_path):
    with pytest.raises(InputError, match=r"v.raw: the suffix says the format, one of .vti, .nii, .nii.gz$"):
        write_volumes(tmp_path / "v.raw", VOLUMES)
    with pytest.raises(InputError, match="the suffix says the format"):
        suffix_of(tmp_path / ".vti")


def test_a_missing_package_is_one_sentence_that_names_the_extra(tmp_path, monkeypatch):
    found = builtins.__import__
    gone = {"nibabel"}

    def without(name, *args, **kwargs):
        if name in gone:
            raise ImportError(name)
        return found(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(NotInstalledError, match=re.escape("needs nibabel: pip install 'spectral-ct[io]'")):
        write_volumes(tmp_path / "v.nii", VOLUMES)
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_fails_leaves_what_was_there(tmp_path, monkeypatch):
    def half(_, path):
        path.write_text("half")
        raise OSError(13, "denied")

    monkeypatch.setattr(nibabel, "save", half)
    (tmp_path / "v.nii").write_text("mine")
    with pytest.raises(StorageError, match="cannot be written: Permission denied"):
        write_volumes(tmp_path / "v.nii", VOLUMES)
    assert [p.name for p in tmp_path.iterdir()] == ["v.nii"]
    assert (tmp_path / "v.nii").read_text() == "mine"


def test_a_volume_must_fit_its_grid():
    with pytest.raises(InputError, match=r"the volume a has shape \(1, 1, 1\), its grid \(3, 4, 5\)"):
        Volumes(GRID, {"a": np.zeros((1, 1, 1))}, "")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return make(tmp_path_factory.mktemp("data") / "tiny.h5", "--views", "2", "--test-views", "0", rows=8, columns=8)


def command(*arguments):
    return CliRunner().invoke(phantomgen, ["export", *map(str, arguments)])


def test_the_truth_of_a_dataset_is_exported(dataset, tmp_path):
    truth = read_truth(dataset)
    result = command(dataset, "-o", tmp_path / "t.vti")
    assert result.exit_code == 0, result.output
    assert result.stdout == f"Wrote {tmp_path / 't.vti'}: photoelectric, compton, kedge_63.3, 16 x 16 x 16 voxels\n"
    image = pyvista.read(tmp_path / "t.vti")
    for name, values in zip(truth.basis_names, truth.volumes, strict=True):
        assert np.array_equal(image.point_data[name].reshape(truth.grid.shape), values)


def test_labels_are_exported_as_whole_numbers(dataset, tmp_path):
    truth = read_truth(dataset)
    result = command(dataset, "--labels", "-o", tmp_path / "t.nii.gz", "--json")
    assert '"volumes": ["labels"]' in result.stdout
    image = nibabel.load(tmp_path / "t.nii.gz")
    assert image.get_data_dtype() == np.uint8
    assert np.array_equal(np.asarray(image.dataobj), truth.labels.T)
    assert b"1 soft_tissue, 2 bone" in image.header.extensions[0].get_content()


def test_exports_that_cannot_be_are_one_sentence(dataset, tmp_path):
    mine = tmp_path / "mine.vti"
    mine.write_text("mine")
    assert "add --overwrite" in one_sentence(command(dataset, "-o", mine))
    assert "one of .vti, .nii, .nii.gz" in one_sentence(command(dataset, "-o", tmp_path / "t.ply"))
    assert "there is no dataset" in one_sentence(command(tmp_path / "none.h5", "-o", tmp_path / "t.vti"))
    assert mine.read_text() == "mine"
