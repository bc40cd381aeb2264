"""``recon align``: what it prints and writes, and how it ends."""

import json

import pytest
from click.testing import CliRunner
from support.tiny_scans import make, one_sentence

from phantomgen.cli.main import main as phantomgen
from recon.cli.main import main


def run(*arguments: object):
    return CliRunner().invoke(main, ["align", *map(str, arguments)])


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    folder = tmp_path_factory.mktemp("align")
    make(folder / "scan.h5", "--views", "16", "--test-views", "2", rows=16, columns=24)
    wrong = [folder / "scan.h5", "-o", folder / "wrong.h5", "--shift", "0.8"]
    assert CliRunner().invoke(phantomgen, ["degrade", *map(str, wrong)]).exit_code == 0
    return folder / "wrong.h5"


@pytest.mark.slow
def test_a_shifted_panel_is_corrected(scan, tmp_path):
    out = tmp_path / "aligned.h5"
    result = run(scan, "-o", out)
    assert result.exit_code == 0, result.output
    line = next(line for line in result.stdout.splitlines() if line.startswith("shift along the columns"))
    assert float(line.split()[-2]) == pytest.approx(-0.8, abs=0.05)
    assert f"Wrote {out}; next: recon fit {out}" in result.stdout
    info = CliRunner().invoke(phantomgen, ["info", str(out)])
    said = next(line for line in info.stdout.splitlines() if line.startswith("aligned    shift along the columns: -0."))
    assert float(said.split()[5]) == pytest.approx(-0.8, abs=0.05)
    assert CliRunner().invoke(phantomgen, ["validate", str(out)]).exit_code == 0
    again = run(out, "--json", "--free", "columns")
    found = json.loads(again.stdout)
    assert found["file"] is None
    assert found["correction"]["columns"]["value"] == pytest.approx(0.0, abs=0.05)
    assert found["correction"]["tilt"]["uncertainty"] is None


def test_bad_requests_are_one_sentence_and_write_nothing(scan, tmp_path):
    assert "'roll'" in one_sentence(run(scan, "-o", tmp_path / "a.h5", "--free", "roll"))
    assert "is the scan itself" in one_sentence(run(scan, "-o", scan))
    assert "there is no dataset" in one_sentence(run(tmp_path / "none.h5", "-o", tmp_path / "a.h5"))
    assert "whose name ends in" in one_sentence(run(scan, "-o", tmp_path / "a.nii"))
    assert list(tmp_path.iterdir()) == []
