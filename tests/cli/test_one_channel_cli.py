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


@pytest.mark.parametrize("method", [None, "fdk-water", "nmar"])
def test_one_channel_gives_both_bases(scan, tmp_path, method):
    chosen = [] if method is None else ["--method", method]
    result = fit(scan, "--bases", "curve:water,Ti", *chosen, "-o", tmp_path / "run")
    assert result.exit_code == 0, result.output
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert metrics["method"]["method"] == (method or "one-step")
    assert metrics["method"]["curve"]["materials"] == ["water", "Ti"]
    assert metrics["basis"]["compton"]["psnr"] > 15
    volume = ["volume", str(tmp_path / "run"), "--energy", "70", "-o", str(tmp_path / "mono.nii")]
    assert CliRunner().invoke(recon, volume).exit_code == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--bases", "curve", "--method", "sirt"], "--method sirt takes no curve of materials"),
        (["--bases", "curve", "--method", "gaussian"], "--method gaussian takes no curve of materials"),
        (["--method", "nmar"], "nmar needs a curve of materials: add --bases curve"),
        (["--method", "polyner"], "polyner needs a curve of materials: add --bases curve"),
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
