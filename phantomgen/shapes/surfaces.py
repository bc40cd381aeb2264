"""Surfaces of triangles in place of solids that bend."""

from collections.abc import Callable
from math import pi

import numpy as np
from jaxtyping import Float, Int64

from phantomgen.ops.primitives import BALL, BOX, CYLINDER
from phantomgen.shapes.base import Shape
from phantomgen.shapes.meshes.mesh import Mesh, merge_equal
from spectra.errors import InputError

CELLS = 24  # squares along each edge of the cube that a solid's surface is drawn on, at fineness 1

Points = Float[np.ndarray, "point 3"]


class BentMesh(Mesh):
    """A mesh whose surface was checked before it bent."""

    def __post_init__(self) -> None:
        """Take vertices and triangles as they are."""


def surface_of(shape: Shape, fineness: int = 1) -> Mesh:
    """Return a surface of triangles with the volume of a shape.

    Parameters
    ----------
    shape : a mesh, a sphere, an ellipsoid, a cylinder or a box, also placed
    fineness : triangles are so many times finer than usual

    Returns
    -------
    the surface

    Raises
    ------
    InputError
        When it is another shape.
    """
    parts = [part for term in shape.terms for part in term]
    part = parts[0]
    if len(parts) > 1 or (part.surface is None and part.kind not in (BALL, CYLINDER, BOX)):
        raise InputError(
            "a shape that deforms is a sphere, an ellipsoid, a cylinder, a box, a sweep or a mesh, without clip planes "
            f"and not combined, got {type(shape).__name__.lower()}"
        )
    if part.surface is not None:
        return BentMesh(*part.surface)
    vertices, triangles = _unit_surface(part.kind, CELLS * fineness)
    axes = np.linalg.inv(part.local[:, :3])
    turned = triangles if np.linalg.det(axes) > 0 else triangles[:, ::-1]
    return BentMesh((vertices - part.local[:, 3]) @ axes.T, turned)


def bent(mesh: Mesh, moved: Callable[[Points], Points]) -> Mesh:
    """Move the corners of a mesh.

    Parameters
    ----------
    mesh : at rest
    moved : map of points [mm]

    Returns
    -------
    the mesh there
    """
    return BentMesh(moved(mesh.vertices), mesh.triangles, mesh.name)


def _unit_surface(kind: int, cells: int) -> tuple[Points, Int64[np.ndarray, "triangle 3"]]:
    """Surface of a primitive in its own coordinates: that of a cube, whose corners are moved onto it."""
    vertices, triangles = _cube(cells)
    if kind == BOX:
        return vertices, triangles
    columns = slice(3) if kind == BALL else slice(2)
    across = vertices[:, columns]
    length = np.linalg.norm(across, axis=1, keepdims=True)
    edge = np.abs(across).max(axis=1, keepdims=True)
    vertices[:, columns] = across * np.divide(edge, length, out=np.zeros_like(edge), where=length > 0)
    enclosed, exact = Mesh(vertices, triangles).volume, 4 / 3 * pi if kind == BALL else 2 * pi
    vertices[:, columns] *= (exact / enclosed) ** (1 / 3 if kind == BALL else 1 / 2)
    return vertices, triangles


def _cube(cells: int) -> tuple[Points, Int64[np.ndarray, "triangle 3"]]:
    """Surface of the cube -1 .. 1, with squares of two triangles; squares are those of equal angles from the middle."""
    steps = np.tan(np.linspace(-pi / 4, pi / 4, cells + 1))
    steps[[0, -1]] = -1.0, 1.0
    u, v = (part.ravel() for part in np.meshgrid(steps, steps, indexing="ij"))
    corner = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    a, b, c, d = (part.ravel() for part in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]))
    face = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    vertices, triangles = [], []
    for axis in range(3):
        for side in (-1.0, 1.0):
            square = np.empty((len(u), 3))
            square[:, axis], square[:, (axis + 1) % 3], square[:, (axis + 2) % 3] = side, u, v
            triangles.append((face if side > 0 else face[:, ::-1]) + len(vertices) * len(u))
            vertices.append(square)
    return merge_equal(np.concatenate(vertices), np.concatenate(triangles).astype(np.int64))
