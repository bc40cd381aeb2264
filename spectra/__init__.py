"""Energy: sources, attenuation, bases, detectors and the transmission of X-rays.

Nothing in here knows space, files or a command line. The public names are imported when first used.
"""

from importlib import import_module
from typing import Any

_HOME = {
    "Basis": "basis",
    "BasisFunction": "basis",
    "BeamQuality": "quality",
    "Channel": "detector",
    "Conditioning": "conditioning",
    "DeadTime": "dead_time",
    "Detector": "detector",
    "EnergyIntegrating": "scintillator",
    "Energies": "energies",
    "Filter": "source",
    "Integrand": "quadrature",
    "Material": "materials",
    "PulseHeightDetector": "pulse_height",
    "ResponseMatrix": "response_matrix",
    "Sharing": "pulse_height",
    "Part": "mixing",
    "Quadrature": "quadrature",
    "Source": "source",
    "Transmission": "transmission",
    "cheapest": "quadrature",
    "conditioning_of": "conditioning",
    "dissolve": "mixing",
    "edge_energy": "attenuation",
    "half_value_layers": "quality",
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
