"""Completion by the Tab key, as shells ask for it."""

import pytest
from click.shell_completion import ShellComplete

from phantomgen.cli.main import main as phantomgen
from recon.cli.main import main as recon


def completed(program, name, words, incomplete):
    """What a shell offers after the words."""
    found = ShellComplete(program, {}, name, f"_{name.upper()}_COMPLETE").get_completions(words, incomplete)
    return [item.value for item in found]


@pytest.mark.parametrize(
    ("program", "name", "words", "incomplete", "expected"),
    [
        (phantomgen, "phantomgen", [], "deg", ["degrade"]),
        (phantomgen, "phantomgen", ["make"], "--tol", ["--tol"]),
        (phantomgen, "phantomgen", ["make", "--preset"], "kedge-s", ["kedge-small", "kedge-sphere"]),
        (phantomgen, "phantomgen", ["presets", "show"], "aor", ["aorta"]),
        (recon, "recon", ["fit", "--recipe"], "", ["fast", "best", "paper"]),
        (recon, "recon", ["fit", "--method"], "one", ["one-step"]),
    ],
)
def test_the_tab_key_offers_commands_options_and_choices(program, name, words, incomplete, expected):
    assert completed(program, name, words, incomplete) == expected
