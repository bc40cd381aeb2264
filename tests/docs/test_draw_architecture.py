"""The picture of the architecture is that of the import contracts."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "docs" / "development"))
from draw_architecture import PICTURE, layers_of, picture


def test_the_picture_is_that_of_the_import_contracts():
    drawn = PICTURE.read_text(encoding="utf-8")
    assert drawn == picture(), "run python docs/development/draw_architecture.py"


@pytest.mark.slow
def test_every_module_of_the_contracts_is_drawn():
    names = [name for package in ("recon", "phantomgen", "spectra") for layer in layers_of(package) for name in layer]
    assert len(names) > 40
    assert all(f">{name}</text>" in picture() for name in names)
