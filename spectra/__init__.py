"""Energy: sources, attenuation, bases, detectors and the transmission of X-rays.

Nothing in here knows space, files or a command line. The public names are imported when first used.
"""

from importlib import import_module
from typing import Any

_HOME = {
    "Basis": "basis.basis",
    "BasisFunction": "basis.basis",
    "BeamQuality": "source.beam_quality",
    "Channel": "detector.detector",
    "Conditioning": "basis.conditioning",
    "DeadTime": "detector.dead_time",
    "Detector": "detector.detector",
    "EnergyIntegrating": "detector.scintillator",
    "Energies": "energy.grid",
    "Filter": "source.source",
    "Integrand": "quadrature",
    "Material": "materials.material",
    "PulseHeightDetector": "detector.pulse_height",
    "ResponseMatrix": "detector.response_matrix",
    "ChargeSharing": "detector.pulse_height",
    "Part": "materials.mixing",
    "Quadrature": "quadrature",
    "Source": "source.source",
    "Transmission": "transmission",
    "cheapest": "quadrature",
    "conditioning_of": "basis.conditioning",
    "dissolve": "materials.mixing",
    "edge_energy": "elements.attenuation",
    "half_value_layers": "source.beam_quality",
    "linear_attenuation": "elements.attenuation",
    "mass_attenuation": "elements.attenuation",
    "mix_by_mass": "materials.mixing",
    "mix_by_volume": "materials.mixing",
}

__all__ = list(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Import a public name from its module."""
    if name not in _HOME:
        raise AttributeError(f"module 'spectra' has no attribute {name!r}")
    return getattr(import_module(f"spectra.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    """Public names."""
    return sorted(__all__)
