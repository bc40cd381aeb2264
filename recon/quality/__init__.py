"""Image quality of any volume: profiles, regions of interest, noise power and edge response.

Functions take arrays and the grid of their voxels, and return numbers; none needs a dataset or a truth.
"""

from recon.quality.edge_response import edge_response, edge_width, mtf
from recon.quality.noise_power import noise_power
from recon.quality.profile import Profile, profile
from recon.quality.region import Statistics, ball, contrast_to_noise, rod, statistics

__all__ = [
    "Profile",
    "Statistics",
    "ball",
    "contrast_to_noise",
    "edge_response",
    "edge_width",
    "mtf",
    "noise_power",
    "profile",
    "rod",
    "statistics",
]


def __dir__() -> list[str]:
    """Public names."""
    return __all__
