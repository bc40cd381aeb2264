"""The code of the page about PyTorch runs from top to bottom, and does what the page says."""

import re
from pathlib import Path

import pytest

from phantomgen.simulation.checks.verification import MeasuredError

PAGE = Path(__file__).parents[2] / "docs/howto/torch.md"


@pytest.mark.slow
def test_the_blocks_of_the_page_are_one_script_that_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("phantomgen.simulation.run.quick_check", lambda *_: MeasuredError(0, 0, 0, 0, 0, 0, 0))
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    assert len(blocks) == 5
    names: dict = {}
    for number, block in enumerate(blocks):
        exec(compile(block, f"{PAGE.name}, block {number}", "exec"), names)
    assert names["losses"][-1] < 0.7 * names["losses"][0]
    assert names["deviances"][-1] < names["deviances"][0]
    assert float(names["error"]) < 0.6
    assert abs(names["offset"].grad.item()) > 0
    assert names["factors"].grad.abs().min() > 0
    assert "slope per channel" in capsys.readouterr().out
