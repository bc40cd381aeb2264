"""Edges in projections, from the fit itself and never from the truth.

Partial volume and the finite size of Gaussians cause model errors in rays that graze a surface. The rays some pixels
away from edges show whether the model holds elsewhere.
"""

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

INSIDE = 0.02  # no unit, over the range of an image; larger absolute values lie inside the object; chosen by hand
RIPPLE = 5.0  # robust standard deviations of second derivatives inside the object, below which nothing is an edge
_MAD = 0.6745  # median absolute deviation of a Gaussian over its standard deviation


def edge_mask(
    images: Float[np.ndarray, "image row column"], distance: float = 2.0, sharpness: float = 0.01
) -> Bool[np.ndarray, "row column"]:
    """Find the rays of one view that pass more than `distance` pixels away from every edge.

    The threshold of an image is at least `RIPPLE` robust standard deviations of its second derivatives inside the
    object, so that ripples of a fit do not count as edges, which would hide the rays that it fits worst.

    Parameters
    ----------
    images : line integrals of each basis or log projections of each channel of the fit, never of the truth
    distance : least distance from an edge [pixel]
    sharpness : threshold of an edge: second derivative in any direction, per squared pixel, over the range of the image
        [1/pixel^2]; steps, kinks and the square-root onset of round objects exceed it, their smooth inside does not

    Returns
    -------
    mask of the rays away from edges
    """
    edges = np.zeros(images.shape[1:], bool)
    for image in np.asarray(images, dtype=np.float64):
        span = np.quantile(image, 0.999) - min(np.quantile(image, 0.001), 0.0)
        if span > 0:
            bends = _second_derivatives(image)
            inside = np.abs(image) > INSIDE * span
            ripple = np.median(np.abs(bends[:2, inside])) / _MAD if inside.any() else 0.0
            edges |= _spectral_norm(*bends) > max(sharpness * span, RIPPLE * ripple)
    return np.asarray(ndimage.distance_transform_edt(~edges)) > distance if edges.any() else ~edges


def _second_derivatives(image: np.ndarray) -> Float[np.ndarray, "3 row column"]:
    """Central second differences along rows, along columns and mixed [1/pixel^2]."""
    p = np.pad(image, 1, mode="reflect", reflect_type="odd")
    middle = p[1:-1, 1:-1]
    return np.stack(
        [
            p[2:, 1:-1] - 2 * middle + p[:-2, 1:-1],
            p[1:-1, 2:] - 2 * middle + p[1:-1, :-2],
            (p[2:, 2:] - p[2:, :-2] - p[:-2, 2:] + p[:-2, :-2]) / 4,
        ]
    )


def _spectral_norm(rows: np.ndarray, columns: np.ndarray, mixed: np.ndarray) -> np.ndarray:
    """Largest absolute eigenvalue of [[rows, mixed], [mixed, columns]]."""
    return np.abs(rows + columns) / 2 + np.hypot((rows - columns) / 2, mixed)
