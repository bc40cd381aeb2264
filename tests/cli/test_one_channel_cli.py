"""``recon fit --bases curve``: scans with one channel."""

import json

import pytest
from click.testing import CliRunner
from support.one_channel_scans import ROD, WATER, one_channel_scan

from recon.cli.main import main as recon


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    path = tmp_path_factory.mktemp("one") / "one.h5"
    small = {"panel": {"rows": 24, "columns": 36, "pitch": 5}, "volume": {"voxels": 20, "size": 80}}
    with one_channel_scan(path, WATER, ROD, **small):
        return path


def fit(*arguments):
    return CliRunner().invoke(recon, ["fit", *map(str, arguments), "--no-figures", "-q"])


@pytest.mark.parametrize(
    ("method", "more"),
    [
        ("one-step", ()),
        ("one-step", ("--scatter", "compton")),
        ("fdk-water", ()),
        ("nmar", ()),
        ("gaussian-poly", ("--sweeps", "30")),
    ],
)
def test_one_channel_gives_both_bases(scan, tmp_path, method, more):
    result = fit(scan, "--bases", "curve:water,Ti", "--method", method, *more, "-o", tmp_path / "run")
    assert result.exit_code == 0, result.output
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert metrics["method"]["method"] == method
    assert metrics["method"]["curve"]["materials"] == ["water", "Ti"]
    assert metrics["basis"]["compton"]["psnr"] > 15
    volume = ["volume", str(tmp_path / "run"), "--energy", "70", "-o", str(tmp_path / "mono.nii")]
    assert CliRunner().invoke(recon, volume).exit_code == 0


@pytest.fixture(scope="module")
def gaussian_run(scan, tmp_path_factory):
    folder = tmp_path_factory.mktemp("gaussians") / "run"
    result = fit(scan, "--bases", "curve:water,Ti", "--sweeps", "1", "-o", folder)
    assert result.exit_code == 0, result.output
    return folder


def test_gaussians_are_fitted_on_a_curve_by_default(gaussian_run, tmp_path):
    metrics = json.loads((gaussian_run / "metrics.json").read_text())
    assert metrics["curve"]["materials"] == ["water", "Ti"]
    assert metrics["gaussians"] > 0
    assert metrics["basis"]["compton"]["psnr"] > 15
    volume = ["volume", str(gaussian_run), "--energy", "70", "-o", str(tmp_path / "mono.nii")]
    assert CliRunner().invoke(recon, volume).exit_code == 0


def test_a_material_with_a_k_edge_in_the_beam_adds_its_function(scan, tmp_path):
    run = tmp_path / "run"
    result = fit(scan, "--bases", "curve:water,Ti,Au", "--sweeps", "1", "-o", run)
    assert result.exit_code == 0, result.output
    names = json.loads((run / "scan.json").read_text())["basis"]["basis_name"]
    assert names == ["photoelectric", "compton", "kedge_Au"]
    image = ["volume", str(run), "--as", "hu", "--energy", "70", "-o", str(tmp_path / "hu.nii"), "-q"]
    assert CliRunner().invoke(recon, image).exit_code == 0
    replicates = ["uncertainty", str(run), "--dataset", str(scan), "--replicates", "2", "-q"]
    assert CliRunner().invoke(recon, replicates).exit_code == 0


@pytest.mark.parametrize("method", ["gaussian", "one-step"])
def test_replicates_of_a_run_are_on_its_curve(scan, gaussian_run, tmp_path, method):
    folder = gaussian_run
    if method == "one-step":
        folder = tmp_path / "run"
        assert fit(scan, "--bases", "curve:water,Ti", "--method", method, "-o", folder).exit_code == 0
    asked = ["uncertainty", str(folder), "--dataset", str(scan), "--replicates", "2", "-q"]
    result = CliRunner().invoke(recon, asked)
    assert result.exit_code == 0, result.output
    assert (folder / "uncertainty.h5").is_file()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--bases", "curve", "--method", "sirt"], "--method sirt takes no curve of materials"),
        (["--bases", "curve", "--recipe", "paper"], "the recipe paper takes no curve of materials"),
        (["--bases", "curve", "--kernel", "gaussian"], "--kernel cannot be used with --bases curve"),
        (["--bases", "curve", "--residual"], "--residual cannot be used with --bases curve"),
        (["--bases", "curve", "--phases", "2"], "--phases cannot be used with --bases curve"),
        (["--bases", "curve", "--edge", "auto"], "lie on a curve of materials"),
        (["--method", "nmar"], "nmar needs a curve of materials: add --bases curve"),
        (["--method", "polyner"], "polyner needs a curve of materials: add --bases curve"),
        (["--method", "gaussian-poly"], "gaussian-poly needs a curve of materials: add --bases curve"),
        (["--bases", "curve:water,,Ti"], "curve: takes materials with commas between"),
        (["--bases", "curve:watr,Ti"], "watr"),
        (["--bases", "curve:Ti", "--method", "fdk-water"], "with water: add --bases curve"),
    ],
)
def test_what_does_not_fit_together_is_refused(scan, tmp_path, arguments, words):
    result = fit(scan, *arguments, "-o", tmp_path / "run")
    assert result.exit_code != 0
    assert words in " ".join(result.output.split())
    assert not (tmp_path / "run").exists()
