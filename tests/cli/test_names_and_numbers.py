"""Options that are no numbers, names that are too long, and lists that are empty are one sentence."""

import pytest
from click.testing import CliRunner
from support.tiny_scans import make, one_sentence

from phantomgen.cli.main import main as phantomgen
from recon.cli.main import main as recon

LONG = "z" * 300


@pytest.mark.parametrize(
    ("program", "arguments"),
    [
        (phantomgen, ("make", f"{LONG}.yaml")),
        (phantomgen, ("validate", f"{LONG}.h5")),
        (recon, ("fit", f"{LONG}.h5")),
        (recon, ("report", LONG)),
        (recon, ("volume", LONG)),
    ],
)
def test_names_that_are_too_long_are_shortened_in_one_sentence(program, arguments):
    sentence = one_sentence(CliRunner().invoke(program, arguments))
    assert "File name too long" in sentence or "there is no" in sentence
    assert len(sentence) < 200


@pytest.mark.parametrize(
    ("program", "arguments"),
    [
        (phantomgen, ("make", "kedge", "--tol", "nan")),
        (phantomgen, ("plan", "kedge", "--tol", "inf")),
        (recon, ("fit", "scan.h5", "--memory", "nan")),
        (recon, ("fit", "scan.h5", "--sweeps", "nan")),
        (recon, ("volume", "run", "--energy", "nan")),
    ],
)
def test_options_that_are_no_numbers_are_wrong_usage(program, arguments):
    result = CliRunner().invoke(program, arguments)
    assert result.exit_code == 2
    assert "is not a finite number" in result.stderr


def test_a_comparison_without_methods_is_refused(tmp_path):
    scan = make(tmp_path / "scan.h5", "--views", "4")
    result = CliRunner().invoke(recon, ["compare", str(scan), "--methods", "", "-o", str(tmp_path / "out")])
    assert "a comparison needs methods: choose from" in one_sentence(result)
    assert not (tmp_path / "out").exists()
