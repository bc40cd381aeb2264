"""Length of a ray inside a closed mesh, as short as its formula."""

import numpy as np
from jaxtyping import Float, Int64


def length_one(
    origin: Float[np.ndarray, " 3"],
    direction: Float[np.ndarray, " 3"],
    vertices: Float[np.ndarray, "vertex 3"],
    triangles: Int64[np.ndarray, "triangle 3"],
) -> float:
    """Compute the length of a ray inside a mesh, ``|d| sum sign(d.n_k) min(max(t_k, 0), 1)``.

    The sum runs over the triangles k that the ray's line meets in t_k, with normals n_k to the outside. Rays through
    vertices and edges count twice or not at all: the caller must leave them out.

    Parameters
    ----------
    origin, direction : the ray ``origin + t direction``, 0 <= t <= 1 [mm]
    vertices, triangles : the mesh [mm]

    Returns
    -------
    length [mm]
    """
    p, q, r = vertices[triangles.T]
    normals = np.cross(q - p, r - p)
    slopes = normals @ direction
    met = slopes != 0
    t = np.einsum("ki,ki->k", normals, p - origin)[met] / slopes[met]
    points = origin + t[:, None] * direction
    ends = [(q - p, p), (r - q, q), (p - r, r)]
    inside = [np.einsum("ki,ki->k", np.cross(s[met], points - x[met]), normals[met]) > 0 for s, x in ends]
    hit = np.logical_and.reduce(inside)
    return float(np.linalg.norm(direction) * (np.sign(slopes[met]) * np.clip(t, 0, 1))[hit].sum())
