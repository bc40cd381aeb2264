"""Deformation: a smooth field of displacements, given at the points of a lattice."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BSpline, make_interp_spline

TRIED = 25  # points along each axis where a field is tried for folds
STEP = 1e-4  # of the size of the lattice; for differences of the field

Points = Float[np.ndarray, "point 3"]


@dataclass(frozen=True, eq=False)
class Lattice:
    """Displacements at the points of a lattice, joined by cubic splines; constant beyond it.

    Parameters
    ----------
    low, high : first and last point (x, y, z) [mm]
    shifts : displacement of each point, with its components x, y and z last [mm]
    """

    low: Float[np.ndarray, " 3"]
    high: Float[np.ndarray, " 3"]
    shifts: Float[np.ndarray, "z y x 3"]

    def displacements(self, points: Points) -> Points:
        """Compute the displacements of points.

        Parameters
        ----------
        points : (x, y, z) [mm]

        Returns
        -------
        displacements [mm]
        """
        clipped = np.clip(points, self.low, self.high)
        weights = [
            _weights(clipped[:, axis], self.low[axis], self.high[axis], self.shifts.shape[2 - axis])
            for axis in (2, 1, 0)
        ]
        return np.einsum("pk,pj,pi,kjic->pc", *weights, self.shifts, optimize=True)

    def fold(self, value: float) -> Float[np.ndarray, " 3"] | None:
        """Find a place where space would fold over, or be flattened.

        Parameters
        ----------
        value : factor of the displacements

        Returns
        -------
        a point (x, y, z) [mm] whose neighbourhood is turned inside out; None where there is none
        """
        axes = [np.linspace(low, high, TRIED) for low, high in zip(self.low, self.high, strict=True)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        step = STEP * float((self.high - self.low).max())
        slopes = [
            (self.displacements(points + shift) - self.displacements(points - shift)) / (2 * step)
            for shift in step * np.eye(3)
        ]
        volumes = np.linalg.det(np.eye(3) + value * np.stack(slopes, axis=-1))
        worst = int(volumes.argmin())
        return points[worst] if volumes[worst] <= 0 else None


def _weights(
    places: Float[np.ndarray, " point"], low: float, high: float, count: int
) -> Float[np.ndarray, "point knot"]:
    """Weights of the values at evenly spaced places in the spline through them."""
    if count == 1:
        return np.ones((len(places), 1))
    knots, degree = np.linspace(low, high, count), min(3, count - 1)
    spline = make_interp_spline(knots, np.eye(count), degree)
    return np.asarray(BSpline(spline.t, spline.c, degree)(places))
