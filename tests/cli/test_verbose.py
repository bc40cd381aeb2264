"""``-v`` logs versions, and time and memory of each stage, on stderr; results on stdout stay as they are."""

import json
import logging
import re

import click
import pytest
from click.testing import CliRunner

from phantomgen.cli.common import PACKAGES
from phantomgen.cli.main import main as phantomgen
from phantomgen.runtime.stopwatch import Stopwatch
from recon.cli.main import main as recon

STAGE = r"^\d\d:\d\d:\d\d views: \d+\.\d s, peak memory so far \d+ MiB$"


def commands_of(group: click.Group) -> list[click.Command]:
    """All commands of a group, those of its groups too."""
    found = []
    for command in group.commands.values():
        found += commands_of(command) if isinstance(command, click.Group) else [command]
    return found


def test_stages_are_logged_once_and_results_stay_as_they_are(tmp_path):
    words = ["make", "kedge-small", "--voxels", "4", "--views", "3", "--test-views", "1", "--json", "-o"]
    silent = CliRunner().invoke(phantomgen, [*words, str(tmp_path / "a.h5")])
    for name in ("b.h5", "c.h5"):
        told = CliRunner().invoke(phantomgen, [*words, str(tmp_path / name), "-v"], prog_name="phantomgen")
        lines = told.stderr.splitlines()
        assert "phantomgen make with python" in lines[0]
        assert "numpy" in lines[0]
        assert len(re.findall(STAGE, told.stderr, re.MULTILINE)) == 1
        assert re.search(r"phantomgen make: \d+\.\d s in all, peak memory \d+ MiB$", lines[-1])
        assert json.loads(told.stdout).keys() == json.loads(silent.stdout).keys()
    assert not any(logging.getLogger(name).handlers for name in PACKAGES)


def test_without_the_option_nothing_is_logged(tmp_path):
    words = ["make", "kedge-small", "--voxels", "4", "--views", "3", "--test-views", "1", "-q"]
    assert not CliRunner().invoke(phantomgen, [*words, "-o", str(tmp_path / "a.h5")]).stderr


@pytest.mark.parametrize("program", [phantomgen, recon])
def test_every_command_with_quiet_has_verbose(program):
    options = [{name for parameter in command.params for name in parameter.opts} for command in commands_of(program)]
    assert any("--quiet" in some for some in options)
    assert all(("--quiet" in some) == ("--verbose" in some) for some in options)


def test_stages_are_logged_for_python(caplog):
    with caplog.at_level(logging.INFO), Stopwatch()("fit"):
        pass
    assert re.match(r"fit: 0\.0 s, peak memory so far \d+ MiB", caplog.messages[0])
