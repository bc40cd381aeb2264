"""The code of the page about notebooks runs from top to bottom, and its numbers are those of the truth."""

import re
from pathlib import Path

import numpy as np
import pytest

from phantomgen.simulation.checks.verification import MeasuredError

PAGE = Path(__file__).parents[2] / "docs/howto/notebook.md"


@pytest.mark.slow
def test_the_blocks_of_the_page_are_one_script_whose_results_agree_with_the_truth(monkeypatch, capsys):
    monkeypatch.setattr("phantomgen.simulation.run.quick_check", lambda *_: MeasuredError(0, 0, 0, 0, 0, 0, 0))
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    names: dict = {}
    for number, block in enumerate(blocks):
        exec(compile(block, f"{PAGE.name}, block {number}", "exec"), names)
    np.testing.assert_allclose(dict(zip(names["truth"].material_names, names["lengths"][0], strict=True))["water"], 20)
    assert names["counts"].shape == (26, 5, 32, 40)
    assert names["named"].dims == ("view", "channel", "row", "column")
    assert len(names["views"]) == 24
    vial = names["quality"].statistics(names["iodine"].values, names["vial"])
    water = names["quality"].statistics(names["values"], names["water"])
    assert 14 < vial.mean < 16  # 15 mg/ml
    assert abs(water.mean) < 20  # HU
    assert names["quality"].edge_width(names["position"], names["response"]) < 3  # of voxels of 1.4 mm
    assert {"axial", "profiles", "materials", "scatter", "sinograms", "spectrum"} <= names["drawn"].keys()
    assert all(figure.axes for figure in names["drawn"].values())
    assert names["power"].shape == names["frequency"].shape
    assert names["scores"]["basis"]["kedge_I"]["psnr"] > 30
    assert len(names["fit"].log) < 225
    assert "20..90 keV" in capsys.readouterr().out
    assert repr(names["softer"]) == "Dataset(scene.h5: closed)"
    assert not names["dataset"].path.exists()
