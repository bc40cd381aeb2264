"""``recon volume --as``: quantities of a run in every format, and what is refused."""

import json
import shutil
from dataclasses import replace

import h5py
import nibabel
import numpy as np
import pytest
import pyvista
from click.testing import CliRunner
from support.gaussian_scenes import small_model

import recon
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.volume_files.read import read_volume
from recon.cli.main import main
from recon.runs.run_folder import MODEL, SCAN, open_run, write_scan
from spectra.basis.basis import Basis, BasisFunction
from spectra.threads import set_threads
from spectra.transmission import Transmission

GRID = Grid((5, 6, 7), (2.0, 1.5, 1.0), (-4.0, -3.75, -3.0))
BASIS = Basis((BasisFunction("photoelectric"), BasisFunction("compton"), BasisFunction("element", element="Gd")))
ENERGY = np.linspace(30, 100, 141)


def command(*arguments):
    return CliRunner().invoke(main, ["volume", *map(str, arguments)])


@pytest.fixture(scope="module", autouse=True)
def _all_threads_again():
    yield
    set_threads(None)


@pytest.fixture(scope="module")
def gaussians(tmp_path_factory):
    """A run folder of fifty Gaussians that nothing was fitted to."""
    folder = tmp_path_factory.mktemp("toy") / "run"
    folder.mkdir()
    replace(small_model(1), basis_names=BASIS.names).save(folder / MODEL)
    weights = np.repeat(np.eye(2), [70, 71], axis=1) * 1e3
    write_scan(folder, GRID, BASIS, Transmission.from_spectrum(weights, BASIS.evaluate(ENERGY)), ("low", "high"))
    return folder


@pytest.fixture(scope="module")
def voxels(gaussians, tmp_path_factory):
    """The same run as one in voxels."""
    folder = tmp_path_factory.mktemp("toy") / "voxels"
    folder.mkdir()
    shutil.copy(gaussians / SCAN, folder)
    assert command(gaussians, "-q", "-o", folder / "volumes.h5").exit_code == 0
    return folder


def expected(run, what, **options):
    return recon.readout(run, what, **options).values


@pytest.mark.parametrize(
    ("options", "name", "unit"),
    [
        (("--as", "vmi", "--energy", "65"), "attenuation_65_keV", "1/mm"),
        (("--as", "hu"), "hounsfield_70_keV", "HU"),
        (("--as", "vnc", "--energy", "50"), "virtual_non_contrast_50_keV", "HU"),
        (("--as", "gadolinium"), "concentration_Gd", "mg/ml"),
        (("--as", "electron-density"), "electron_density", "1"),
        (("--as", "zeff"), "effective_atomic_number", "1"),
    ],
)
@pytest.mark.parametrize("kind", ["gaussians", "voxels"])
def test_quantities_of_runs_of_both_kinds_are_those_of_python(options, name, unit, kind, tmp_path, request):
    run = request.getfixturevalue(kind)
    result = command(run, *options, "-o", tmp_path / "v.h5", "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["unit"] == unit
    energy = float(options[3]) if len(options) > 2 else None
    with h5py.File(tmp_path / "v.h5") as file:
        assert list(file["basis/basis_name"].asstr()) == [name]
        assert file["basis/data"].attrs["units"] == unit
        assert "caution" not in file["basis/data"].attrs
        np.testing.assert_array_equal(file["basis/data"][0], expected(run, options[1], energy=energy))


def test_python_computes_what_readouts_of_arrays_do(gaussians):
    volumes = open_run(gaussians).gaussians.volume(GRID)
    readouts = recon.Readouts.of(BASIS, ENERGY, np.full(141, 1e3))
    found = recon.readout(gaussians, "hu", energy=60.0, water="table")
    assert (found.name, found.unit, found.grid) == ("hounsfield_60_keV", "HU", GRID)
    water = BASIS.evaluate(np.array([60.0]))[:, 0] @ readouts.water
    table = recon.readouts.readouts.tabulated_water(60.0)
    exact = (readouts.hounsfield(volumes, 60.0) + 1000) * water / table - 1000
    np.testing.assert_allclose(np.asarray(found), exact, rtol=1e-4, atol=0.02)
    finer = Grid.cube(4, 6.0)
    assert recon.readout(gaussians, "zeff", grid=finer).values.shape == (4, 4, 4)
    assert repr(found) == "QuantityMap(hounsfield_60_keV [HU]: 5 x 6 x 7 voxels)"


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".vti", ""])
def test_every_format_holds_the_same_values(suffix, voxels, tmp_path):
    path = tmp_path / f"hu{suffix}"
    result = command(voxels, "--as", "hu", "--energy", "60", "-o", path, "-q")
    assert result.exit_code == 0, result.output
    assert f"Wrote {path}: CT numbers at 60 keV [HU], 5 x 6 x 7 voxels" in result.stdout
    exact = expected(voxels, "hu", energy=60.0)
    if suffix == ".vti":
        image = pyvista.read(path)
        np.testing.assert_array_equal(image.point_data["hounsfield_60_keV"], exact.ravel())
        assert list(image.field_data["about"]) == ["CT numbers at 60 keV [HU]"]
    elif suffix:
        image = nibabel.load(path)
        np.testing.assert_array_equal(image.get_fdata().T, exact)
        assert image.header["descrip"].item().decode() == "CT numbers at 60 keV [HU]"
    else:
        np.testing.assert_allclose(read_volume(str(path)).values[:, ::-1, ::-1], np.rint(exact), atol=1e-3)


def test_basis_volumes_go_to_nifti_too(voxels, tmp_path):
    assert command(voxels, "-o", tmp_path / "b.nii", "-q").exit_code == 0
    assert nibabel.load(tmp_path / "b.nii").shape == (7, 6, 5, 3)


@pytest.mark.filterwarnings("default")
def test_an_extrapolation_is_said_on_the_command_line_in_the_file_and_in_python(voxels, tmp_path):
    result = command(voxels, "--energy", "140", "-o", tmp_path / "v.h5", "--json")
    assert result.exit_code == 0
    words = "140 keV is outside of the detected spectrum (nodes at 30 to 100 keV)"
    assert f"Warning: {words}" in result.stderr
    assert words in json.loads(result.stdout)["caution"]
    with h5py.File(tmp_path / "v.h5") as file:
        assert words in file["basis/data"].attrs["caution"]
    with pytest.warns(UserWarning, match="outside of the detected spectrum"):
        recon.readout(voxels, "hu", energy=140.0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--energy", "0"), "--energy must be between 10 and 500 keV, got 0"),
        (("--energy", "-60"), "--energy must be between 10 and 500 keV, got -60"),
        (("--as", "hu", "--energy", "501"), "--energy must be between 10 and 500 keV, got 501"),
        (("--as", "hu", "--water", "ice"), "--water must be one of basis, table, or the attenuation of water"),
        (("--water", "table"), "--water is for CT numbers: add --as hu or --as vnc"),
        (("--as", "iodine"), "cannot show the concentration of I: its functions show Gd"),
        (("--as", "colour"), "there is no quantity 'colour'"),
        (("--as", "zeff", "--energy", "70"), "--energy is for images at one energy"),
        (("--as", "zeff", "-o", "series"), "means a DICOM CT series, and that holds CT numbers"),
        (("--as", "zeff", "-o", "z.jpg"), "z.jpg: the suffix says the format"),
    ],
)
def test_what_is_not_possible_is_one_sentence_and_writes_nothing(options, words, voxels, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = command(voxels, *options)
    assert (result.exit_code, result.stdout, result.stderr.count("\n")) == (1, "", 1)
    assert words in result.stderr
    assert list(tmp_path.iterdir()) == []
