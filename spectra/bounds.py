"""The least noise that counts allow: Cramer-Rao bounds of basis line integrals."""

import numpy as np
from jaxtyping import Float

# Eigenvalues of the scaled information below this part of the largest are zero but for rounding.
_SINGULAR = 1e-13


def least_deviations(information: Float[np.ndarray, "... basis basis"]) -> Float[np.ndarray, "... basis"]:
    """Least standard deviation that an unbiased estimate of each parameter can have.

    Parameters
    ----------
    information : Fisher information, such as `Transmission.fisher` gives

    Returns
    -------
    square roots of the diagonal of its inverse (Kay 1993, Fundamentals of Statistical Signal Processing I, theorem
    3.2); infinite for all parameters where the information is singular: the channels cannot tell them apart
    """
    information = np.asarray(information, dtype=np.float64)
    scale = np.sqrt(np.diagonal(information, axis1=-2, axis2=-1))
    blind = (scale <= 0).any(axis=-1)
    scale = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(information / (scale[..., :, None] * scale[..., None, :]))
    singular = blind | (values[..., 0] <= _SINGULAR * values[..., -1])
    safe = np.where(singular[..., None], 1.0, values)
    deviation = np.sqrt((vectors**2 / safe[..., None, :]).sum(axis=-1)) / scale
    return np.where(singular[..., None], np.inf, deviation)
