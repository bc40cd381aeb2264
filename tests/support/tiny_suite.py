"""A suite of two tiny scans, for tests of commands that make and score suites."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from phantomgen.cli.main import main as phantomgen
from phantomgen.simulation.checks.verification import MeasuredError

DEFINITION = """\
version: 1
name: tiny
base_voxels: 128
test_views: 2
tiers:
  minutes: {voxels: 16, seconds: 60}
  hour: {voxels: 32, seconds: 120}
cases:
  - {name: plain, what: the object as it is, preset: kedge, views: 64, seed: 1}
  - name: misstated
    what: the object with a wrong voltage
    preset: kedge
    views: 64
    seed: 1
    degrade: {kv_error: 10}
"""


def definitions(patch: pytest.MonkeyPatch, folder: Path, text: str = DEFINITION) -> Path:
    """Put a folder with the suite ``tiny`` in the place of the definitions."""
    folder.mkdir(exist_ok=True)
    (folder / "tiny.yaml").write_text(text)
    patch.setattr("phantomgen.suite.definition._FOLDER", folder)
    return folder


def suite(*arguments: object):
    """Run ``phantomgen suite``; how exact the counts are is the business of other tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("phantomgen.simulation.run.quick_check", lambda *_: MeasuredError(0, 0, 0, 0, 0, 0, 0))
        return CliRunner().invoke(phantomgen, ["suite", *map(str, arguments)])


def make_tiny(folder: Path, definition: Path) -> Path:
    """Make the suite ``tiny`` in a folder."""
    with pytest.MonkeyPatch.context() as patch:
        definitions(patch, definition)
        result = suite("tiny", "-o", folder)
    assert result.exit_code == 0, result.output
    return folder
