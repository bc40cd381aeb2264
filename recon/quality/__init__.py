"""Image quality of any volume: profiles, regions of interest, noise power, edge response, model observers.

Functions take arrays and the grid of their voxels, and return numbers; none needs a dataset or a truth.
"""

from recon.quality.edge_response import edge_response, edge_width, mtf
from recon.quality.noise_power import noise_power
from recon.quality.observers import (
    Detectability,
    channelised_hotelling,
    hotelling,
    ideal_square,
    without_prewhitening,
)
from recon.quality.profile import Profile, profile
from recon.quality.region import Statistics, ball, contrast_to_noise, rod, statistics

__all__ = [
    "Detectability",
    "Profile",
    "Statistics",
    "ball",
    "channelised_hotelling",
    "contrast_to_noise",
    "edge_response",
    "edge_width",
    "hotelling",
    "ideal_square",
    "mtf",
    "noise_power",
    "profile",
    "rod",
    "statistics",
    "without_prewhitening",
]


def __dir__() -> list[str]:
    """Public names."""
    return __all__
