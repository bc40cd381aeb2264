"""Reports of runs: what they hold, what they leave out and why, and the curves they compute."""

import json
import re
import shutil

import numpy as np
import pytest
from click.testing import CliRunner
from scipy import ndimage
from support.tiny_scans import make, one_sentence

from phantomgen.cli.main import main as phantomgen
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.truth import read_truth
from phantomgen.geometry.voxel_grid import Grid
from recon.cli.main import main as recon
from recon.data.measurements import matching_bin, read_measurements
from recon.output.report.limits import COARSE, material_limits
from recon.output.report.page import names_of
from recon.output.report.resolution import STEP, edge_of, edge_width, mtf, noise_power
from spectra.errors import InputError


def command(*arguments):
    return CliRunner().invoke(recon, [*map(str, arguments)])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A dataset and two runs of it on voxels."""
    folder = tmp_path_factory.mktemp("runs")
    make(folder / "tiny.h5", "--views", "8", "--test-views", "2")
    for sweeps in (1, 2):
        options = ("--method", "sirt", "--sweeps", sweeps, "--no-figures", "-q", "-o", folder / f"run{sweeps}")
        result = command("fit", folder / "tiny.h5", *options)
        assert result.exit_code == 0, result.output
    return folder


@pytest.fixture(scope="module")
def page(folder):
    result = command("report", folder / "run1", folder / "run2", "-o", folder / "both.html", "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout), (folder / "both.html").read_text(encoding="utf-8")


def test_a_page_of_two_runs_has_all_chapters_and_their_scores(page, folder):
    found, text = page
    chapters = ["Scores", "Volumes", "Materials", "Views", "Energies", "Progress and cost"]
    assert [name for name in chapters if name not in found["sections"]] == []
    for name in ("run1", "run2"):
        metrics = json.loads((folder / name / "metrics.json").read_text(encoding="utf-8"))
        assert f"<td>{metrics['basis']['compton']['psnr']:.2f}</td>" in text


def test_a_page_loads_nothing_from_elsewhere(page):
    assert re.findall(r'(?:src|href)="(?!data:|#)([^"]+)"', page[1]) == []
    assert "Segmentation" in page[0]["left_out"]


@pytest.mark.slow
def test_without_its_dataset_a_page_says_what_is_missing(folder, tmp_path):
    shutil.copytree(folder / "run1", tmp_path / "run1")
    result = command("report", tmp_path / "run1", "-q", "--json")
    found = json.loads(result.stdout)
    assert (tmp_path / "run1" / "report.html").is_file()
    assert "dataset was not found" in found["left_out"]["Views, residuals and sinograms"]
    assert "no truth" in found["left_out"]["Scatter of two bases"]
    assert "Volumes" in found["sections"]


def spoiled(folder, how):
    metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    if how == "nothing":
        (folder / "metrics.json").unlink()
    elif how == "interrupted":
        (folder / "metrics.json").write_text('{"interrupted": {"step": 3}}')
    elif how == "volumes":
        (folder / "volumes.h5").unlink()
    elif how == "torn":
        (folder / "metrics.json").write_text("{")
    elif how == "damaged":
        (folder / "volumes.h5").write_bytes(b"no HDF5")
    else:
        metrics[how[0]] = how[1]
        (folder / "metrics.json").write_text(json.dumps(metrics))


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("nothing", "is not a run folder: it has no metrics.json"),
        ("interrupted", "was interrupted and is not scored"),
        ("volumes", "is incomplete: it has no volumes.h5"),
        ("torn", "is damaged: it is not JSON"),
        ("damaged", "cannot be read as what recon fit writes there"),
        (("versions", {"spectral-ct": "99.0"}), "was written by version 99.0"),
        (("versions", {}), "is of another version"),
        (("dataset", "other.h5"), "runs of different scans do not fit on one page"),
        (("channels", {"low": {}}), "is not the scan of"),
    ],
)
def test_runs_that_cannot_be_read_are_refused_in_a_sentence(how, words, folder, tmp_path):
    shutil.copytree(folder / "run1", tmp_path / "bad")
    spoiled(tmp_path / "bad", how)
    options = ("--dataset", folder / "tiny.h5", "-o", tmp_path / "p.html", "-q")
    assert words in one_sentence(command("report", folder / "run2", tmp_path / "bad", *options))
    assert not (tmp_path / "p.html").exists()


def test_runs_are_called_by_as_much_of_their_path_as_tells_them_apart(tmp_path):
    assert names_of([tmp_path / "a", tmp_path / "b"]) == ["a", "b"]
    assert names_of([tmp_path / "x" / "run", tmp_path / "y" / "run"]) == ["x/run", "y/run"]
    with pytest.raises(InputError, match="is named twice"):
        names_of([tmp_path / "a", tmp_path / "a"])


@pytest.mark.slow
def test_a_dataset_has_a_page_of_its_own(folder, tmp_path):
    result = CliRunner().invoke(
        phantomgen, ["report", str(folder / "tiny.h5"), "-o", str(tmp_path / "d.html"), "--json"]
    )
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["sections"] == [
        "Truth", "Geometry and energies", "Views", "Dose", "Plan and error", "Provenance"
    ]  # fmt: skip
    again = CliRunner().invoke(phantomgen, ["report", str(folder / "tiny.h5"), "-o", str(tmp_path / "d.html")])
    assert "add --overwrite" in one_sentence(again)


@pytest.fixture(scope="module")
def ball():
    """Fractions of a ball of radius 14.3 voxels, from 5 x 5 x 5 points per voxel."""
    axis = (np.arange(48 * 5) + 0.5) / 5 - 24
    inside = axis[:, None, None] ** 2 + axis[:, None] ** 2 + axis**2 < 14.3**2
    return inside.reshape(48, 5, 48, 5, 48, 5).mean(axis=(1, 3, 5))


def test_an_edge_of_voxel_means_is_as_wide_as_a_voxel(ball):
    edge = edge_of(ball, (ball > 0.5).astype(int), 0)
    distance, response = edge.response(ball)
    assert edge_width(distance, response) == pytest.approx(0.8, abs=0.15)  # of a ramp one voxel long
    frequency, transfer = mtf(response, STEP)
    assert np.interp(0.25, frequency, transfer) == pytest.approx(np.sinc(0.25), abs=0.04)


def test_blur_widens_an_edge_as_a_gaussian_does(ball):
    edge = edge_of(ball, (ball > 0.5).astype(int), 0)
    distance, response = edge.response(ndimage.gaussian_filter(ball, 1.0))
    assert edge_width(distance, response) == pytest.approx(2.563 * np.sqrt(1 + 1 / 12), rel=0.06)


def test_noise_power_adds_up_to_the_variance():
    noise = np.random.default_rng(1).normal(scale=0.3, size=(40, 24, 24))
    grid = Grid((40, 24, 24), (1.0, 0.5, 0.5), (0.0, 0.0, 0.0))
    box = (slice(0, 40), slice(0, 24), slice(0, 24))
    power = noise_power(noise, grid, box)[1]
    assert power[2:] == pytest.approx(0.09 * 0.25, rel=0.1)  # white: variance x area of a pixel


def test_limits_are_those_of_finite_differences_of_the_counts(folder):
    truth = read_truth(folder / "tiny.h5")
    with open_dataset(folder / "tiny.h5") as dataset:
        limits = material_limits(dataset, truth)
        measured = read_measurements(dataset, dataset.splits["train"])
        measured = measured.binned(matching_bin(measured.geometry, COARSE * min(truth.grid.spacing)))
    from recon.voxel.model import Voxels

    names = tuple(truth.material_names)
    lengths = Voxels((truth.fractions / 65535).astype(np.float32), truth.grid, names).line_integrals(measured.geometry)
    lengths = lengths.numpy().astype(np.float64)

    def counts(coefficients):
        integrals = np.einsum("vkrc,km->vrcm", lengths, coefficients)
        gains = np.moveaxis(measured.gains, 0, -1) * measured.exposure[:, None, None, :]
        return (measured.transmission.expected(integrals) * gains).ravel()

    step, base = 1e-7, counts(truth.coefficients)
    slopes = []
    for k, m in np.ndindex(truth.coefficients.shape):
        moved = truth.coefficients.copy()
        moved[k, m] += step
        slopes.append((counts(moved) - base) / step)
    seen = base > 1e-9
    information = np.einsum("ar,br->ab", np.array(slopes)[:, seen] / base[seen], np.array(slopes)[:, seen])
    least = np.sqrt(np.diag(np.linalg.inv(information))).reshape(truth.coefficients.shape)
    found = np.array([[limits[name][basis] for basis in truth.basis_names] for name in names])
    np.testing.assert_allclose(found, least, rtol=1e-2)
