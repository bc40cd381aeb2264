"""Rotations."""

from math import cos, sin

import numpy as np
from jaxtyping import Float

Triple = tuple[float, float, float]


def rotation_matrix(angles: Triple) -> Float[np.ndarray, "3 3"]:
    """Compute the rotation about the fixed x axis, then y, then z.

    Parameters
    ----------
    angles : about x, y and z [rad]

    Returns
    -------
    rotation matrix
    """
    (cx, cy, cz), (sx, sy, sz) = map(cos, angles), map(sin, angles)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x
