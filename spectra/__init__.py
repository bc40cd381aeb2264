"""Energy: sources, attenuation, bases, detectors and the transmission of X-rays.

Nothing in here knows space, files or a command line. The public names are imported when first used.
"""

from importlib import import_module
from typing import Any

_HOME = {
    "Basis": "basis",
    "BasisFunction": "basis",
    "Channel": "detector",
    "Conditioning": "conditioning",
    "Detector": "detector",
    "Energies": "energies",
    "Filter": "source",
    "Material": "materials",
    "Part": "mixing",
    "Source": "source",
    "Transmission": "transmission",
    "conditioning_of": "conditioning",
    "dissolve": "mixing",
    "edge_energy": "attenuation",
    "linear_attenuation": "attenuation",
    "mass_attenuation": "attenuation",
    "mix_by_mass": "mixing",
    "mix_by_volume": "mixing",
}

__all__ = list(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Import a public name from its module."""
    if name not in _HOME:
        raise AttributeError(f"module 'spectra' has no attribute {name!r}")
    return getattr(import_module(f"spectra.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
