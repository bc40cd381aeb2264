"""Focal spot of finite size.

Model: photons start from the points of a spot that faces the panel: its width lies along the step from column to
column, its height along that from row to row, through the source point of the view. All points send the same photons
to every pixel; a pixel measures the average of intensities over them. The panel stays where it is. By similar
triangles, an edge at magnification M = SDD / SOD is blurred on the panel by M - 1 times the spot.

Points are a lattice with equal weights (Sloan & Joe 1994, "Lattice Methods for Multiple Integration"): n of them have
n different places along the width, and along the height, whereas a product of two rules has sqrt(n). The view of each
point is averaged over pixels exactly, so errors at edges along rows or columns fall with the square of n. Lattices that
look alike after a quarter turn, step^2 = -1 modulo n, integrate xy exactly and err least at slanting edges and corners.
"""

from dataclasses import dataclass
from math import ceil, log, sqrt

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri

from spectra.errors import InputError

# Full width at half maximum of a normal distribution, in standard deviations.
FWHM = 2 * sqrt(2 * log(2))
SHAPES = ("uniform", "gaussian")
# Larger spots [mm] are sizes in micrometres by mistake.
_LARGEST = 50.0
# Points of a lattice, and its second generator: the best ones of each size that look alike after a quarter turn.
LATTICES = {1: 0, 5: 2, 13: 5, 29: 12, 53: 23, 89: 34, 169: 70, 233: 89, 985: 408}
# Points for a blur of one pixel, and the most that are taken unasked; measured by benchmarks/simulator/focal_spot.py.
_POINTS, _MOST = 15.0, 233
# A normal spot wants as many points as an even one of so many times its width.
_TAILS = 2.0
# Objects closer to the source than this part of the way to the panel are taken to be there.
_NEAREST = 0.05


@dataclass(frozen=True)
class FocalSpot:
    """Focal spot: a rectangle, or a normal distribution, of points that photons start from.

    Parameters
    ----------
    width, height : along the steps to the next column and row [mm]: full size, for `gaussian` full width at half
        maximum; one of them may be 0
    shape : ``uniform`` or ``gaussian``

    Raises
    ------
    InputError
        When the spot has no size, more than 50 mm, or an unknown shape.
    """

    width: float
    height: float
    shape: str = "uniform"

    def __post_init__(self) -> None:
        if self.shape not in SHAPES:
            raise InputError(f"a focal spot must be {' or '.join(SHAPES)}, got {self.shape!r}")
        if not (0 <= self.width <= _LARGEST and 0 <= self.height <= _LARGEST and self.width + self.height > 0):
            raise InputError(
                f"a focal spot needs a width or a height above 0 and at most {_LARGEST:g} mm, got {self.width:g} mm x "
                f"{self.height:g} mm"
            )

    def offsets(self, n: int) -> Float[np.ndarray, "point 2"]:
        """Compute the source points of the smallest lattice of at least `n` points.

        Parameters
        ----------
        n : least number of points

        Returns
        -------
        places along width and height from the spot's centre [mm]
        """
        places = spot_lattice(_at_least(n))
        if self.shape == "gaussian":
            places = ndtri(places + 0.5)
            # Middles of equal parts lack the far tails: keep the variance.
            places /= FWHM * max(sqrt((places[:, 0] ** 2).mean()), 1e-300)
        return places * (self.width, self.height)

    def frames(
        self, frame: Float[np.ndarray, "4 3"], n: int, steps: Float[np.ndarray, "2 3"] | None = None
    ) -> Float[np.ndarray, "point 4 3"]:
        """Compute the ray frames of `n` source points; the panel does not move.

        Parameters
        ----------
        frame : source, vector to pixel (0, 0), column step and row step [mm]
        n : least number of points
        steps : column and row step that the spot lies along, those of `frame` by default

        Returns
        -------
        frames, (point, 4, 3)
        """
        steps = frame[2:] if steps is None else steps
        along = steps / np.linalg.norm(steps, axis=1, keepdims=True)
        moved = self.offsets(n) @ along
        frames = np.tile(frame, (len(moved), 1, 1))
        frames[:, 0] += moved
        frames[:, 1] -= moved
        return frames

    def blur(self, frame: Float[np.ndarray, "4 3"], places: Float[np.ndarray, "place 3"]) -> float:
        """Compute the widest blur of edges in the object, (1 / t - 1) spots with t the relative distance to the panel.

        Parameters
        ----------
        frame : source, vector to pixel (0, 0), column step and row step [mm]
        places : places in the object [mm]

        Returns
        -------
        blur [pixel]
        """
        way = np.linalg.solve(frame[1:].T, (places - frame[0]).T)[0]
        pixels = np.linalg.norm(frame[2:], axis=1)
        widest = float((np.array([self.width, self.height]) / pixels).max())
        return widest * float((1 / np.clip(way, _NEAREST, 1.0) - 1).max(initial=0.0))

    def points_for(self, blur: float) -> int:
        """Return the number of points that errs by about 3e-3 of the contrast, at worst, at a given blur of edges.

        Parameters
        ----------
        blur : width of the blur [pixel]

        Returns
        -------
        number of points
        """
        wide = blur * (_TAILS if self.shape == "gaussian" else 1.0)
        return _at_least(max(1, min(ceil(_POINTS * wide**1.5), _MOST)))


def spot_lattice(n: int) -> Float[np.ndarray, "point 2"]:
    """Compute points of the square [-1/2, 1/2]^2, symmetric to its centre, with `n` different places along each side.

    Parameters
    ----------
    n : number of points

    Returns
    -------
    points, (point, 2)
    """
    number = np.arange(n) - n // 2
    return np.stack([number, (number * LATTICES[n] + n // 2) % n - n // 2], axis=1) / n


def _at_least(n: int) -> int:
    """Size of the smallest lattice of at least `n` points."""
    if not 1 <= n <= max(LATTICES):
        raise InputError(f"a focal spot must have 1 to {max(LATTICES)} points, got {n}")
    return next(size for size in LATTICES if size >= n)
