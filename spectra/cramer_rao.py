"""The least noise that counts allow: Cramer-Rao bounds of basis line integrals."""

import numpy as np
from jaxtyping import Float

# Eigenvalues of the scaled information below this part of the largest are zero but for rounding.
_SINGULAR = 1e-12


def least_covariance(information: Float[np.ndarray, "... basis basis"]) -> Float[np.ndarray, "... basis basis"]:
    """Return the Cramer-Rao bound: the smallest covariance that unbiased estimates of parameters can have.

    Parameters
    ----------
    information : Fisher information, (..., M, M), such as `Transmission.fisher` returns

    Returns
    -------
    inverse of the Fisher information, (..., M, M); infinite where the information is singular, because the channels
    cannot separate the parameters

    References
    ----------
    Kay 1993, Fundamentals of Statistical Signal Processing I, theorem 3.2
    """
    information = np.asarray(information, dtype=np.float64)
    size = np.sqrt(np.diagonal(information, axis1=-2, axis2=-1))
    scale = np.where(size > 0, size, 1.0)
    scale = scale[..., :, None] * scale[..., None, :]
    scaled = information / scale
    inverse = _inverse_of_regular(scaled)
    if inverse is None:
        eigenvalues = np.linalg.eigvalsh(scaled)
        known = (eigenvalues[..., 0] > _SINGULAR * eigenvalues[..., -1])[..., None, None]
        inverse = np.where(known, np.linalg.inv(np.where(known, scaled, np.eye(information.shape[-1]))), np.inf)
    return inverse / scale


def _inverse_of_regular(
    matrices: Float[np.ndarray, "... basis basis"],
) -> Float[np.ndarray, "... basis basis"] | None:
    """Invert matrices, in half the time that their eigenvalues take; None where one may be singular.

    The ratio of the eigenvalues is at most the product of the Frobenius norms of a matrix and its inverse.
    """
    try:
        inverse = np.linalg.inv(matrices)
    except np.linalg.LinAlgError:
        return None
    squares = [np.einsum("...mn,...mn->...", part, part) for part in (matrices, inverse)]
    return inverse if np.sqrt(squares[0] * squares[1]).max(initial=0) < 1 / _SINGULAR else None


def least_deviations(information: Float[np.ndarray, "... basis basis"]) -> Float[np.ndarray, "... basis"]:
    """Return the least standard deviation of an unbiased estimate of each parameter.

    Parameters
    ----------
    information : Fisher information, (..., M, M)

    Returns
    -------
    square roots of the diagonal of `least_covariance`, (..., M)
    """
    return np.sqrt(np.diagonal(least_covariance(information), axis1=-2, axis2=-1))
