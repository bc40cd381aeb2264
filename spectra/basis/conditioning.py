"""Well-conditioned combinations of basis functions, for solvers only.

Raw photoelectric and Compton columns are nearly parallel over a detected spectrum, and iterations in them crawl. A
solver works with T B, orthonormal in the weighted norm, and converts its coefficients back; files, scores and
positivity stay with the raw basis.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from spectra.errors import InputError

# No unit; functions with a larger condition number cannot be separated in float64, whose digits are 1e-16.
_HIGHEST_CONDITION = 1e12


@dataclass(frozen=True, eq=False)
class Conditioning:
    """Linear change of basis B' = T B with alpha' = alpha T^-1, so that alpha' B' = alpha B.

    Parameters
    ----------
    transform : T
    inverse : T^-1
    """

    transform: Float[np.ndarray, "basis basis"]
    inverse: Float[np.ndarray, "basis basis"]

    def columns(self, raw: Float[np.ndarray, "basis energy"]) -> Float[np.ndarray, "basis energy"]:
        """Convert raw functions to conditioned ones.

        Parameters
        ----------
        raw : raw columns, (M, E)

        Returns
        -------
        conditioned columns, (M, E)
        """
        return self.transform @ raw

    def conditioned(self, raw: Float[np.ndarray, "... basis"]) -> Float[np.ndarray, "... basis"]:
        """Convert coefficients or line integrals from the raw to the conditioned basis.

        Parameters
        ----------
        raw : values in the raw basis, (..., M)

        Returns
        -------
        values in the conditioned basis, (..., M)
        """
        return raw @ self.inverse

    def raw(self, conditioned: Float[np.ndarray, "... basis"]) -> Float[np.ndarray, "... basis"]:
        """Convert coefficients or line integrals from the conditioned to the raw basis.

        Parameters
        ----------
        conditioned : values in the conditioned basis, (..., M)

        Returns
        -------
        values in the raw basis, (..., M)
        """
        return conditioned @ self.transform


def conditioning_of(columns: Float[np.ndarray, "basis energy"], weights: Float[np.ndarray, " energy"]) -> Conditioning:
    """Whiten basis columns in the norm of `weights`: (T B) W (T B)^T = 1 for sum(W) = 1.

    Symmetric whitening of the unit-norm columns stays closest to the raw functions, so that a conditioned coefficient
    keeps the meaning of its raw one.

    Parameters
    ----------
    columns : raw basis columns, (M, E)
    weights : weight of each energy, such as photons per node

    Returns
    -------
    transform and inverse

    Raises
    ------
    InputError
        When the columns cannot be separated (condition number of their correlation matrix above 1e12).
    """
    share = np.asarray(weights, dtype=np.float64) / np.sum(weights)
    gram = (columns * share) @ columns.T
    norm = np.sqrt(np.diag(gram))
    if not (np.isfinite(norm).all() and (norm > 0).all()):
        raise InputError(f"basis function {int(np.argmin(norm))} vanishes over the whole detected spectrum")
    values, vectors = np.linalg.eigh(gram / np.outer(norm, norm))
    if values[0] * _HIGHEST_CONDITION < values[-1]:
        pair = np.sort(np.argsort(np.abs(vectors[:, 0]))[-2:])
        raise InputError(f"basis functions {pair[0]} and {pair[1]} cannot be told apart over the detected spectrum")
    transform = (vectors / np.sqrt(values)) @ vectors.T / norm
    inverse = (vectors * np.sqrt(values)) @ vectors.T * norm[:, None]
    return Conditioning(transform, inverse)
