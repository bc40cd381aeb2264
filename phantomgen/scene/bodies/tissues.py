"""Materials of bodies, with and without a contrast agent.

Tissues are those of ICRU Report 44 by name. Concentrations of the agent are parts of the peak in arteries; they follow
the order of enhancement in clinical CT (Bae 2010, Radiology 256, 32, doi:10.1148/radiol.10090908) and are nominal.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from phantomgen.scene.schema.bodies import ContrastModel

Materials = dict[str, dict[str, Any]]

# Part of the peak in the tissues of each phase.
_UPTAKE = {
    "arterial": {"arteries": 1.0, "veins": 0.15, "heart": 0.2, "kidney": 0.45, "spleen": 0.3, "liver": 0.04},
    "portal": {"arteries": 0.45, "veins": 0.45, "heart": 0.15, "kidney": 0.5, "spleen": 0.3, "liver": 0.2},
    "late": {"arteries": 0.2, "veins": 0.2, "heart": 0.1, "kidney": 0.3, "spleen": 0.12, "liver": 0.12},
}
_SOLVENT = {"arteries": "blood", "veins": "blood"}
# Lungs at the end of exhaling and of inhaling [g/cm^3].
_LUNG_DENSITY = (0.38, 0.22)
_LUNG = {"H": 0.103, "C": 0.105, "N": 0.031, "O": 0.749, "Na": 0.002, "P": 0.002, "S": 0.003, "Cl": 0.003, "K": 0.002}
_AMALGAM = {"Hg": 0.5, "Ag": 0.3, "Sn": 0.14, "Cu": 0.06}
_OWN: Materials = {
    "gold alloy": {"composition": {"Au": 0.75, "Ag": 0.15, "Cu": 0.10}, "density": 15.5},
    "amalgam": {"composition": _AMALGAM, "density": 11.6},
    "enamel": {"composition": "hydroxyapatite", "density": 2.9},
    "plaque": {"mixture": {"by": "volume", "parts": {"hydroxyapatite": 0.3, "soft tissue": 0.7}}},
}


def lung(inflation: float) -> Materials:
    """Return the material of inflated lungs.

    Parameters
    ----------
    inflation : 0 at the end of exhaling, 1 at the end of inhaling

    Returns
    -------
    material by name
    """
    low, high = _LUNG_DENSITY
    return {"inflated lung": {"composition": dict(_LUNG), "density": round(low + (high - low) * inflation, 4)}}


def own(objects: Iterable[Mapping[str, Any]]) -> Materials:
    """Return the materials of alloys, teeth and plaques that some objects have.

    Parameters
    ----------
    objects : as a scene file has them

    Returns
    -------
    materials by name
    """
    used = {item.get("material") for item in objects}
    return {name: material for name, material in _OWN.items() if name in used}


class Uptake:
    """Names of tissues that a contrast agent reaches.

    Parameters
    ----------
    contrast : the agent and the phase; None for none
    """

    def __init__(self, contrast: ContrastModel | None) -> None:
        self.contrast = contrast

    def __getitem__(self, tissue: str) -> str:
        """Return the name of the material of a tissue."""
        plain = _SOLVENT.get(tissue, tissue)
        return plain if self.contrast is None else f"{tissue}, {self.contrast.phase} phase"

    @property
    def materials(self) -> Materials:
        """Solutions of the agent in the tissues, by name."""
        if self.contrast is None:
            return {}
        peak, element = self.contrast.peak, self.contrast.element
        return {
            self[tissue]: {
                "solution": {"solvent": _SOLVENT.get(tissue, tissue), "solutes": {element: round(part * peak, 4)}}
            }
            for tissue, part in _UPTAKE[self.contrast.phase].items()
        }
