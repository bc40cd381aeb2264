"""Few functions of energy that many are combinations of."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import qr, solve_triangular

# A column that no ray meets counts as if one met it over this part of the longest path.
_UNMET = 1e-3
# One ray in so many shows that too few columns are kept, before all rays are summed.
_GLANCE = 50


class Combinations(NamedTuple):
    """Columns as combinations of some of them.

    Parameters
    ----------
    picked : indices of the columns that are kept
    mixture : coefficients of every column in these
    error : largest error of the sum over columns of length x column that was found, no unit
    """

    picked: Int[np.ndarray, " few"]
    mixture: Float[np.ndarray, "column few"]
    error: float


def interpolative_decomposition(
    columns: Float[np.ndarray, "column node"], lengths: Float[np.ndarray, "ray column"], tolerance: float
) -> Combinations:
    """Select the columns that the others are combinations of, to a tolerance on all rays.

    Attenuation curves of tissues and solutions differ by little more than photoelectric effect, scattering and the
    elements dissolved, so that twenty of them are combinations of six.

    Parameters
    ----------
    columns : attenuation curves, or other functions of energy
    lengths : of rays, their products with columns have no unit
    tolerance : largest error of the sum over columns of length x column, over all rays and nodes

    Returns
    -------
    the columns that are kept, and the others in them

    Notes
    -----
    Columns are chosen by QR decomposition with pivoting, scaled by their longest path (interpolative decomposition:
    Cheng, Gimbutas, Martinsson, Rokhlin 2005, doi:10.1137/030602678).
    """
    longest = np.abs(lengths).max(axis=0, initial=0.0)
    largest = float(longest.max(initial=0.0)) or 1.0
    sizes = np.where(longest > 0, longest, _UNMET * largest)
    _, upper, order = qr((columns * sizes[:, None]).T, mode="economic", pivoting=True)  # pyright: ignore[reportAssignmentType]
    for rank in range(1, len(columns)):
        picked = order[:rank]
        mixture = np.zeros((len(columns), rank))
        mixture[picked] = np.eye(rank)
        mixture[order[rank:]] = solve_triangular(upper[:rank, :rank], upper[:rank, rank:]).T
        mixture *= sizes[picked] / sizes[:, None]
        missing = columns - mixture @ columns[picked]
        if np.abs(lengths[::_GLANCE] @ missing).max(initial=0.0) > tolerance:
            continue
        error = float(np.abs(lengths @ missing).max(initial=0.0))
        if error <= tolerance:
            return Combinations(picked, mixture, error)
    return Combinations(np.arange(len(columns)), np.eye(len(columns)), 0.0)
