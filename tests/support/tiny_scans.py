"""Tiny scans for tests of the reconstructor, made by the command."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from phantomgen.cli.main import main as phantomgen
from phantomgen.simulation.checks.verification import MeasuredError


def make(path: Path, *arguments: str, voxels: int = 16, rows: int = 32, columns: int = 32) -> Path:
    """A scan of `kedge-small` with few pixels and voxels."""
    panel = f"panel={{rows: {rows}, columns: {columns}, pitch: {204.8 / columns}}}"
    options = ["--preset", "kedge-small", "-q", "-o", str(path), "--voxels", str(voxels), "--set", panel, *arguments]
    with pytest.MonkeyPatch.context() as patch:  # how exact the counts are is the business of other tests
        patch.setattr("phantomgen.simulation.run.quick_check", lambda *_: MeasuredError(0, 0, 0, 0, 0, 0, 0))
        result = CliRunner().invoke(phantomgen, ["make", *options])
    assert result.exit_code == 0, result.output
    return path


def one_sentence(result) -> str:
    """What a command that failed has said."""
    assert (result.exit_code, result.stdout) == (1, ""), result.output
    assert result.stderr.startswith("Error: ")
    assert result.stderr.count("\n") == 1
    return result.stderr
