"""Kernels are compiled ahead by small scans and a small fit, which leave no files."""

import tempfile

import pytest
from click.testing import CliRunner

from phantomgen.cli.main import main as phantomgen
from recon.cli.main import main as recon


@pytest.mark.parametrize(("program", "name"), [(phantomgen, "phantomgen"), (recon, "recon")])
@pytest.mark.slow
def test_kernels_are_compiled_ahead_and_nothing_is_left(program, name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    result = CliRunner().invoke(program, ["warm-up", "-q"])
    assert result.exit_code == 0, result.output
    assert f"kernels of {name} are compiled" in result.output
    assert not list(tmp_path.iterdir())
