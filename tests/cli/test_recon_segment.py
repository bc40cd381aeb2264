"""``recon segment`` on run folders whose volumes are the truth of a tiny scan, or made by a few Gaussians."""

import json

import h5py
import numpy as np
import pytest
import torch
from click.testing import CliRunner
from support.tiny_scans import make, one_sentence

from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.truth import read_truth
from recon.api import segment
from recon.cli.main import main as recon
from recon.gaussians.model import Gaussians
from recon.runs.run_folder import MODEL, SCAN, write_scan
from recon.runs.write_run import write_volumes
from recon.segmentation.output.files import POINTS, TABLE, VOLUMES
from spectra.threads import set_threads
from spectra.transmission import Transmission


def command(*arguments):
    return CliRunner().invoke(recon, ["segment", *map(str, arguments)])


@pytest.fixture(scope="module", autouse=True)
def _all_threads_again():
    yield
    set_threads(None)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "tiny.h5"
    return make(path, "--views", "4", "--test-views", "1", voxels=40, rows=24, columns=24)


@pytest.fixture(scope="module")
def voxels(dataset):
    """A run of a method on voxels that made no error, beside its dataset."""
    truth = read_truth(dataset)
    folder = dataset.parent / "voxels-run"
    folder.mkdir()
    write_volumes(folder / "volumes.h5", truth.volumes, truth.basis_names, truth.grid, {})
    _write_scan(folder, dataset)
    return folder


@pytest.fixture(scope="module")
def gaussians(dataset):
    """A run whose Gaussians stand in every voxel of the truth."""
    truth = read_truth(dataset)
    folder = dataset.parent / "gaussians-run"
    folder.mkdir()
    filled = np.argwhere(truth.volumes.sum(axis=0) > 0)
    values = truth.volumes[:, *filled.T].T / (np.sqrt(2 * np.pi) * 0.6) ** 3
    points = np.array(truth.grid.origin) + filled * truth.grid.spacing
    turn = torch.zeros(len(points), 4)
    turn[:, 0] = 1
    scales = torch.full((len(points), 3), float(np.log(0.6 * truth.grid.spacing[0])))
    parts = torch.from_numpy(points[:, ::-1].copy()).float(), scales, turn, torch.from_numpy(values).float()
    Gaussians(*parts, basis_names=truth.basis_names).save(folder / MODEL)
    _write_scan(folder, dataset)
    return folder


def _write_scan(folder, path):
    with open_dataset(path) as opened:
        basis, grid = opened.spectra.basis, opened.grid
    energy = np.linspace(25, 120, 12)
    transmission = Transmission.from_spectrum(np.ones((1, 12)), basis.evaluate(energy))
    write_scan(folder, grid, basis, transmission, ("one",))
    (folder / "metrics.json").write_text(json.dumps({"dataset": path.name}), encoding="utf-8")


@pytest.mark.parametrize("kind", ["voxels", "gaussians"])
def test_a_run_becomes_volumes_pictures_and_a_table(kind, request, tmp_path):
    run = request.getfixturevalue(kind)
    out = tmp_path / "maps"
    result = command(run, "-o", out, "--energy", "50", "--energy", "70", "--view", "20,10", "--threads", "1")
    assert result.exit_code == 0, result.output
    assert "bone-like" in result.stdout
    assert "50 keV" in result.stdout
    assert "mean Dice of 4 materials" in result.stdout
    assert result.stderr.splitlines() == ["segment ...", "score ...", "write ..."]
    names = {VOLUMES, TABLE, "materials.png", "view_20_10.png"} | ({POINTS} if kind == "gaussians" else set())
    assert {path.name for path in out.iterdir()} == names
    with h5py.File(out / VOLUMES) as file:
        count = len(file["materials/material"])
        assert file["labels/data"][()].max() <= count
        assert file["materials/data"].shape == (count, *file["labels/data"].shape)
        assert file["rgb/data"].dtype == np.uint8
        assert file["readouts/monoenergetic_50_keV/data"].attrs["units"] == "HU"
    table = json.loads((out / TABLE).read_text())
    assert len(table["materials"]) == count
    assert table["scores"]["materials"]["soft_tissue"]["dice"] > 0.9


def test_json_says_what_the_function_returns(voxels, tmp_path):
    result = command(voxels, "-o", tmp_path / "maps", "--json", "--no-figures")
    found = segment(voxels)
    printed = json.loads(result.stdout)
    assert [m["name"] for m in printed["materials"]] == [c.name for c in found.clusters]
    assert printed["domain"] == found.options.domain == "voxels"
    assert result.stderr == ""
    assert not list((tmp_path / "maps").glob("*.png"))


def test_the_folder_goes_into_the_run_and_is_replaced_only_on_demand(voxels):
    assert command(voxels, "-q", "--no-figures").exit_code == 0
    assert (voxels / "segment" / VOLUMES).is_file()
    assert "--overwrite" in one_sentence(command(voxels, "-q", "--no-figures"))
    assert command(voxels, "-q", "--no-figures", "--overwrite").exit_code == 0


def test_a_folder_of_somebody_else_is_not_replaced(voxels, tmp_path):
    said = one_sentence(command(voxels, "-q", "-o", tmp_path, "--overwrite"))
    assert "will not be replaced" in said


def test_points_open_as_ply_with_colours(gaussians, tmp_path):
    command(gaussians, "-o", tmp_path / "maps", "-q", "--no-figures", "--energy", "70")
    raw = (tmp_path / "maps" / POINTS).read_bytes()
    head, body = raw.split(b"end_header\n", 1)
    lines = head.decode().splitlines()
    fields = [(line.split()[2], {"float": "<f4", "uchar": "u1", "ushort": "<u2"}[line.split()[1]]) for line in lines
              if line.startswith("property")]  # fmt: skip
    table = np.frombuffer(body, np.dtype(fields))
    found = segment(gaussians)
    assert len(table) == len(found.subject.gaussians)
    np.testing.assert_array_equal(table["material"], found.gaussian_labels + 1)
    np.testing.assert_allclose(table["x"], found.subject.gaussians.centres[:, 0])
    colours = found.colours[found.gaussian_labels]
    np.testing.assert_allclose(0.5 + 0.28209479 * table["f_dc_1"], colours[:, 1], atol=1e-6)
    np.testing.assert_allclose(table["red"] / 255, colours[:, 0], atol=0.002)


def test_without_truth_there_are_no_scores_and_no_error(voxels, tmp_path):
    away = tmp_path / "away-run"
    away.mkdir()
    for path in voxels.iterdir():
        if path.is_file():
            (away / path.name).write_bytes(path.read_bytes())
    result = command(away, "--no-figures")
    assert result.exit_code == 0
    assert "No scores: the dataset tiny.h5 is not at hand" in result.stderr
    assert "Dice" not in result.stdout
    assert json.loads((away / "segment" / TABLE).read_text())["scores"] is None


def test_one_material_is_said_to_be_one(voxels, dataset, tmp_path):
    truth = read_truth(dataset)
    lonely = tmp_path / "one-run"
    lonely.mkdir()
    tissue = (truth.coefficients[0, :2, None, None, None] * (truth.labels == 1)).astype(np.float32)
    write_volumes(lonely / "volumes.h5", tissue, truth.basis_names[:2], truth.grid, {})
    (lonely / SCAN).write_bytes((voxels / SCAN).read_bytes())
    result = command(lonely, "--no-figures", "-q")
    assert result.exit_code == 0
    assert "one material only" in result.stdout


@pytest.mark.parametrize(
    ("break_it", "said"),
    [
        (lambda run: (run / SCAN).unlink(), "older versions did not write"),
        (lambda run: (run / "volumes.h5").unlink(), "not a run folder"),
        (lambda run: (run / "volumes.h5").write_bytes(b"?"), "cannot be read as what recon fit writes there"),
        (lambda run: (run / SCAN).write_text("{}"), "cannot be read as what recon fit writes"),
    ],
)
def test_broken_runs_are_one_sentence(break_it, said, voxels, tmp_path):
    run = tmp_path / "broken"
    run.mkdir()
    for name in ("volumes.h5", SCAN):
        (run / name).write_bytes((voxels / name).read_bytes())
    break_it(run)
    assert said in one_sentence(command(run))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--energy", "2"], "--energy must be between"),
        (["--view", "up"], "--view needs"),
        (["--domain", "gaussians"], "no Gaussians"),
        (["--features", "own"], "of their own"),
        (["--truth", "missing.h5"], "missing.h5"),
    ],
)
def test_wrong_options_are_one_sentence(options, said, voxels, tmp_path):
    assert said in one_sentence(command(voxels, "-q", "-o", tmp_path / "maps", *options))
