"""Where edges lie in a projection, as the fit itself sees them.

Partial volume and the finite size of Gaussians put a model error into rays that graze a surface. Whether the model is
right elsewhere shows in the rays that pass some pixels away; which ones do must not be taken from the truth.
"""

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage


def edge_mask(
    images: Float[np.ndarray, "image row column"], distance: float = 2.0, sharpness: float = 0.01
) -> Bool[np.ndarray, "row column"]:
    """Rays of one view that pass more than `distance` pixels away from every edge.

    Parameters
    ----------
    images : the fit's own line integrals of each basis, or its log projections of each channel; never the truth
    distance : [pixel]
    sharpness : an edge is where the second derivative along some direction, per squared pixel, exceeds this part of the
        image's range: steps, kinks and the square-root onset of round objects, but not their smooth inside

    The threshold of an image is raised to five robust standard deviations of its second derivatives inside the object,
    so that ripples of a fit are not taken for edges, which would hide the rays that it fits worst.
    """
    edges = np.zeros(images.shape[1:], bool)
    for image in np.asarray(images, dtype=np.float64):
        span = np.quantile(image, 0.999) - min(np.quantile(image, 0.001), 0.0)
        if span > 0:
            bends = _second_derivatives(image)
            inside = np.abs(image) > 0.02 * span
            ripple = np.median(np.abs(bends[:2, inside])) / 0.6745 if inside.any() else 0.0
            edges |= _spectral_norm(*bends) > max(sharpness * span, 5 * ripple)
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
