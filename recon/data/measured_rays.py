"""Weights of rays that were not measured."""

import numpy as np
from jaxtyping import Bool, Float32


def ray_weights(unseen: Bool[np.ndarray, "row column"], views: int) -> Float32[np.ndarray, "view row column"] | None:
    """Return statistical weights that leave out unseen pixels.

    Parameters
    ----------
    unseen : pixels in which too few channels measure
    views : number of views

    Returns
    -------
    1 for rays that were measured and 0 for others; None where all were measured
    """
    return np.broadcast_to(~unseen, (views, *unseen.shape)).astype(np.float32) if unseen.any() else None
