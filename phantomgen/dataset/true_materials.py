"""Densities and compositions of the true materials, which only the score reads."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from phantomgen.dataset.checks.door import value_at
from phantomgen.dataset.file import damaged_file, open_file
from phantomgen.dataset.layout import text_of
from spectra.elements.attenuation import Composition


@dataclass(frozen=True)
class TrueMaterial:
    """A material as the truth states it.

    Parameters
    ----------
    name : of the material
    density : [g/cm^3], None where the scene states none
    composition : formula, name or mass fractions; None where the scene states coefficients
    """

    name: str
    density: float | None
    composition: Composition | None


def read_true_materials(path: Path | str) -> tuple[TrueMaterial, ...]:
    """Read the materials of a dataset's truth.

    Parameters
    ----------
    path : the dataset, which has a truth

    Returns
    -------
    materials in the order of `phantomgen.dataset.truth.Truth.material_names`
    """
    path = Path(path)
    with open_file(path, "truth") as file, damaged_file(path):
        names = value_at(file, "truth/materials/name")
        densities = value_at(file, "truth/materials/density")
        texts = [text_of(text) for text in value_at(file, "truth/materials/composition")]
    return tuple(
        TrueMaterial(str(name), None if np.isnan(density) else float(density), _composition(text))
        for name, density, text in zip(names, densities, texts, strict=True)
    )


def _composition(text: str) -> Composition | None:
    """Composition from what `phantomgen.dataset.truth` writes."""
    return json.loads(text) if text.startswith("{") else text or None
