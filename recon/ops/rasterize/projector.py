"""How a Gaussian is projected: over which area a pixel averages it, where it ends, and which formula holds."""

import math
from dataclasses import dataclass
from typing import NamedTuple

from spectra.errors import InputError

CUTOFF = 3.7  # standard deviations; beyond it a footprint is below 1.1e-3 of its peak
FARTHEST = 5.0  # largest cutoff that the kernels' exponential allows [standard deviations]
PROJECTORS = ("exact", "local-affine")


class PixelSampling(NamedTuple):
    """A `Projector` as the kernels read it.

    Parameters
    ----------
    box : variance that averaging over a pixel adds to a footprint, along x and along y [pixel^2]
    cutoff : where a footprint ends [standard deviations]
    affine : whether the projection is local-affine
    """

    box: float
    cutoff: float
    affine: bool


@dataclass(frozen=True)
class Projector:
    """How Gaussians are projected onto pixels.

    Parameters
    ----------
    footprint : edge of the square that a pixel averages over [pixels]; 0 samples the pixel centre
    cutoff : where a footprint ends [standard deviations], at most 5; `cutoff_for` computes it from an error
    kind : ``exact``; or ``local-affine``, which treats rays near a Gaussian as parallel to the ray through its centre,
        as splatting methods do; its errors are in ``benchmarks/results/gaussian_projector.txt``

    Raises
    ------
    InputError
        When the cutoff or the kind is not one of those above.
    """

    footprint: float = 1.0
    cutoff: float = CUTOFF
    kind: str = "exact"

    def __post_init__(self) -> None:
        if not 0 < self.cutoff <= FARTHEST:
            raise InputError(
                f"rasterize: cutoff must be above 0 and at most {FARTHEST:g} standard deviations, got {self.cutoff:g}"
            )
        if self.kind not in PROJECTORS:
            raise InputError(f"rasterize: projector must be {' or '.join(PROJECTORS)}, got {self.kind}")

    @property
    def affine(self) -> bool:
        """Whether the projection is local-affine."""
        return self.kind == "local-affine"

    @property
    def box(self) -> float:
        """Variance that averaging over a pixel adds to a footprint, along x and along y [pixel^2]."""
        return self.footprint**2 / 12

    @property
    def sampling(self) -> PixelSampling:
        """Return the numbers for the kernels."""
        return PixelSampling(self.box, float(self.cutoff), self.affine)


EXACT = Projector()


def cutoff_for(error: float) -> float:
    """Compute the cutoff at which a footprint has fallen to a given part of its peak.

    Parameters
    ----------
    error : largest error of truncation, relative to the peak. It is also the part of a footprint's sum that is cut off,
        by which line integrals through many Gaussians are too small.

    Returns
    -------
    cutoff [standard deviations]

    Raises
    ------
    InputError
        When the error is not below 1, or below what the largest cutoff leaves, 3.7e-6.
    """
    least = math.exp(-(FARTHEST**2) / 2)
    if not least <= error < 1:
        raise InputError(f"error of truncation must be from {least:.2g} to below 1 of the peak, got {error:g}")
    return math.sqrt(-2 * math.log(error))
