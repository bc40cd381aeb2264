"""The check of docstrings finds what is missing and nothing else."""

from pathlib import Path

import pytest

pytest.importorskip("numpydoc")

from benchmarks.check_docstrings import ROOT, findings

CHECKS = {"GL08", "PR01", "PR02", "RT01", "YD01"}
SOURCE = '''
from dataclasses import dataclass, field


@dataclass
class Sheet:
    """Sheet of absorber.

    Parameters
    ----------
    thickness : [mm]
    colour : no field has this name
    """

    thickness: float
    material: str
    kept: int = field(init=False)
    {gap}
    @property
    def mass(self) -> float:
        """Mass [g]."""
        return 1.0

    def _private(self, x):
        return x


def half(x):
    """Halve a number."""
    return x / 2


def plain(x):
    pass


def told(x):
    """Double a number.

    Parameters
    ----------
    x : the number

    Returns
    -------
    twice the number
    """
    return 2 * x
'''.replace("    {gap}\n", "\n")


def test_missing_sections_are_found(tmp_path: Path):
    path = tmp_path / "sheet.py"
    path.write_text(SOURCE)
    found = {(name, check) for _, name, check, _ in findings(path, CHECKS)}
    assert found == {("Sheet", "PR01"), ("Sheet", "PR02"), ("half", "PR01"), ("half", "RT01"), ("plain", "GL08")}


def test_a_checked_file_has_none():
    assert findings(ROOT / "spectra" / "threads.py", CHECKS) == []
