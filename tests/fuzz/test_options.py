"""Any option of any command, with values that it does not expect, on tiny scenes and scans."""

import click
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from support.door import run, tries
from support.mutations import OPTIONS
from support.tiny_scans import make

from phantomgen.cli.main import main as phantomgen
from recon.cli.main import main as recon

pytestmark = pytest.mark.filterwarnings("default")
LEFT_OUT = {"view", "warm-up", "stress"}  # open a window or a server, compile for a minute, compute for seconds
COMMON = {"help", "version", "debug", "json", "quiet"}
STARTS_WORK = {"fit", "compare", "make", "plan", "segment", "degrade", "edge"}


def commands(group, path=()):
    """All commands below a group, as words with the command."""
    for name, command in group.commands.items():
        if isinstance(command, click.Group):
            yield from commands(command, (*path, name))
        elif name not in LEFT_OUT:
            yield (*path, name), command


COMMANDS = tuple((program, *entry) for program in (phantomgen, recon) for entry in commands(program))


@pytest.fixture(scope="module")
def scan(place):
    """A tiny scan beside the scene of a wrong kind of file."""
    make(place / "scan.h5", "--views", "3", voxels=4, rows=4, columns=4)
    (place / "run").mkdir()
    (place / "text.yaml").write_text("a: 1\n")
    return place


def usual(argument):
    """A file that an argument of the command may name."""
    return {"dataset": "scan.h5", "scan": "scan.h5", "file": "scan.h5", "run": "run"}.get(argument.name, "missing")


@tries(50)
@given(data=st.data())
@pytest.mark.slow
def test_options_with_values_they_do_not_expect(scan, data):
    program, words, command = data.draw(st.sampled_from(COMMANDS))
    arguments = [
        data.draw(st.sampled_from((usual(parameter), "text.yaml", "missing", *OPTIONS)))
        if data.draw(st.integers(0, 3)) == 0
        else usual(parameter)
        for parameter in command.params
        if isinstance(parameter, click.Argument)
    ]
    options = [p for p in command.params if isinstance(p, click.Option) and p.name not in COMMON]
    for option in data.draw(st.lists(st.sampled_from(options), max_size=3)) if options else ():
        arguments.append(option.opts[-1])
        if not option.is_flag:
            arguments += [data.draw(st.sampled_from(OPTIONS)) for _ in range(option.nargs)]
    if words[-1] in STARTS_WORK:  # ends in a sentence before anything is computed
        arguments = [word if word != "scan.h5" else "missing.h5" for word in arguments]
    run(program, *words, *arguments)


def test_all_commands_are_tried():
    assert len(COMMANDS) > 20
    result = CliRunner().invoke(recon, ["--help"])
    assert all(words[0] in result.output for program, words, _ in COMMANDS if program is recon)
