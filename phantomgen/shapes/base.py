"""Base of all shapes: each consists of unit primitives under affine maps.

A primitive says how its local axes lie in space, ``x_world = center + axes @ x_local``. A shape is a union of terms; a
term is what lies inside all of some primitives and outside some others. Bounds, points, chords and silhouettes follow
from that.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from math import pi, prod
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int64

from phantomgen.ops.mesh import enclosures
from phantomgen.ops.primitives import BALL, BOX, CONE, CYLINDER, HALFSPACE, MESH, TORUS
from phantomgen.ops.voxel_maps import VoxelMap
from spectra.errors import InputError

Triple = tuple[float, float, float]
Surface = tuple[Float[np.ndarray, "vertex 3"], Int64[np.ndarray, "triangle 3"]]
Bounds = tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]

_UNIT_VOLUME = {BALL: 4 / 3 * pi, CYLINDER: 2 * pi, BOX: 8.0, CONE: pi / 3}


@dataclass(frozen=True, eq=False)
class Part:
    """Primitive that a term lies inside, or outside.

    Parameters
    ----------
    kind : code of `phantomgen.ops.primitives`
    local : map from world [mm] to local coordinates, ``x_local = local[:, :3] @ x + local[:, 3]``
    inside : whether the term lies inside
    tube : radius of the tube of a torus in local coordinates
    surface : vertices [mm] and triangles of a mesh
    voxels : what fills the box of a voxel map
    """

    kind: int
    local: Float[np.ndarray, "3 4"]
    inside: bool = True
    tube: float = 0.0
    surface: Surface | None = None
    voxels: VoxelMap | None = None

    @property
    def opposite(self) -> "Part":
        """The rest of space."""
        return replace(self, inside=not self.inside)

    def placed(self, matrix: Float[np.ndarray, "3 3"], offset: Float[np.ndarray, " 3"]) -> "Part":
        """Transform the part: every point x goes to ``matrix @ x + offset``.

        Parameters
        ----------
        matrix : (3, 3)
        offset : [mm]

        Returns
        -------
        the transformed part
        """
        if self.surface is not None:
            vertices, triangles = self.surface
            turned = triangles if np.linalg.det(matrix) > 0 else triangles[:, ::-1]
            return replace(mesh_part(vertices @ matrix.T + offset, turned), inside=self.inside)
        linear = self.local[:, :3] @ np.linalg.inv(matrix)
        return replace(self, local=np.column_stack([linear, self.local[:, 3] - linear @ offset]))

    @property
    def bounds(self) -> Bounds:
        """Lowest and highest corner of the tight box around the primitive [mm]."""
        if self.kind == HALFSPACE:
            return np.full(3, -np.inf), np.full(3, np.inf)
        axes = np.linalg.inv(self.local[:, :3])
        center = -axes @ self.local[:, 3]
        if self.voxels is not None:
            low, high = self.voxels.filled_box
            center, axes = center + axes @ ((low + high) / 2), axes * ((high - low) / 2)
        disc, rod = np.linalg.norm(axes[:, :2], axis=1), np.abs(axes[:, 2])
        if self.kind == CONE:
            tip, base = center, center + axes[:, 2]
            return np.minimum(tip, base - disc), np.maximum(tip, base + disc)
        reach = {
            BALL: np.linalg.norm(axes, axis=1),
            CYLINDER: disc + rod,
            BOX: np.abs(axes).sum(axis=1),
            MESH: np.abs(axes).sum(axis=1),
            TORUS: (1 - self.tube) * disc + self.tube * np.linalg.norm(axes, axis=1),
        }[self.kind]
        return center - reach, center + reach

    def contains(self, points: Float[np.ndarray, "point 3"]) -> Bool[np.ndarray, " point"]:
        """Return which points the part contains; flat faces are half open.

        Parameters
        ----------
        points : (x, y, z) [mm], (point, 3)

        Returns
        -------
        True for points inside
        """
        if self.surface is not None:
            return (enclosures(points, *self.surface) % 2 == 1) == self.inside
        x, y, z = self.local[:, :3] @ np.asarray(points, dtype=np.float64).T + self.local[:, 3:]
        within = {
            BALL: lambda: x**2 + y**2 + z**2 < 1,
            CYLINDER: lambda: (x**2 + y**2 < 1) & (z >= -1) & (z < 1),
            BOX: lambda: _in_box(x, y, z, self.voxels),
            CONE: lambda: (x**2 + y**2 < z**2) & (z >= 0) & (z < 1),
            HALFSPACE: lambda: z < 0,
            TORUS: lambda: (np.hypot(x, y) - 1 + self.tube) ** 2 + z**2 < self.tube**2,
        }[self.kind]()
        return within if self.inside else ~within


Term = tuple[Part, ...]


def _in_box(x: np.ndarray, y: np.ndarray, z: np.ndarray, voxels: VoxelMap | None) -> Bool[np.ndarray, " point"]:
    """Return which local points lie in a box, of a voxel map only in voxels that are not empty."""
    if voxels is not None:
        return np.any(voxels.at(np.stack([x, y, z])) > 0, axis=1)
    return (x >= -1) & (x < 1) & (y >= -1) & (y < 1) & (z >= -1) & (z < 1)


def mesh_part(vertices: Float[np.ndarray, "vertex 3"], triangles: Int64[np.ndarray, "triangle 3"]) -> Part:
    """Create the part inside a closed mesh.

    Parameters
    ----------
    vertices : (x, y, z) [mm], (vertex, 3)
    triangles : indices of vertices, (triangle, 3)

    Returns
    -------
    the part
    """
    low, high = vertices[triangles.ravel()].min(axis=0), vertices[triangles.ravel()].max(axis=0)
    half = np.maximum((high - low) / 2, 1e-9)
    return Part(MESH, local_map(np.diag(half), (low + high) / 2), surface=(vertices, triangles))


class Shape(ABC):
    """Region of space; subclasses are frozen dataclasses."""

    @property
    @abstractmethod
    def terms(self) -> tuple[Term, ...]:
        """Terms whose union is the shape."""

    @property
    def volume(self) -> float | None:
        """Volume [mm^3], where it has a closed form."""
        return None

    @property
    def bounds(self) -> Bounds:
        """Lowest and highest corner of an axis-aligned box around the shape [mm]; tight unless something is cut off."""
        boxes = [[part.bounds for part in term if part.inside] for term in self.terms]
        low = np.min([np.max([low for low, _ in box], axis=0) for box in boxes], axis=0)
        return low, np.max([np.min([high for _, high in box], axis=0) for box in boxes], axis=0)

    def contains(self, points: Float[np.ndarray, "point 3"]) -> Bool[np.ndarray, " point"]:
        """Return which points lie inside.

        Parameters
        ----------
        points : (x, y, z) [mm], (point, 3)

        Returns
        -------
        True for points inside
        """
        inside = np.zeros(len(points), np.bool_)
        for term in self.terms:
            inside |= np.logical_and.reduce([part.contains(points) for part in term])
        return inside


class Primitive(Shape):
    """Shape that is one primitive around a centre."""

    KIND: ClassVar[int]
    center: Triple

    @property
    @abstractmethod
    def axes(self) -> Float[np.ndarray, "3 3"]:
        """Half axes as columns [mm], orthogonal to each other."""

    @property
    def local(self) -> Float[np.ndarray, "3 4"]:
        """Map from world [mm] to local coordinates, ``x_local = local[:, :3] @ x + local[:, 3]``."""
        return local_map(self.axes, np.asarray(self.center, dtype=np.float64))

    @property
    def terms(self) -> tuple[Term, ...]:
        """One term of one part."""
        return ((Part(self.KIND, self.local),),)

    @property
    def volume(self) -> float:
        """Volume [mm^3]."""
        return _UNIT_VOLUME[self.KIND] * float(np.prod(np.linalg.norm(self.axes, axis=0)))


def local_map(axes: Float[np.ndarray, "3 3"], center: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 4"]:
    """Compute the map from world coordinates [mm] to coordinates along orthogonal `axes` from `center`.

    Parameters
    ----------
    axes : half axes as columns [mm]
    center : (x, y, z) [mm]

    Returns
    -------
    map, (3, 4)
    """
    inverse = (axes / (axes**2).sum(axis=0)).T
    return np.column_stack([inverse, -inverse @ center])


def shortest_turn(axis: Triple) -> Float[np.ndarray, "3 3"]:
    """Compute the rotation that takes z into `axis` about their common normal.

    Parameters
    ----------
    axis : direction, any length

    Returns
    -------
    rotation matrix; a half turn about x where the axis is -z
    """
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    if x * x + y * y == 0:
        return np.diag([1.0, z, z])
    # Rodrigues' formula with the turn's axis (-y, x, 0); 1 + z = (x^2 + y^2) / (1 - z) keeps its digits near -z.
    lift = (x * x + y * y) / (1 - z) if z < 0 else 1 + z
    return np.array([[1 - x * x / lift, -x * y / lift, x], [-x * y / lift, 1 - y * y / lift, y], [-x, -y, z]])


def checked_triple(shape: str, name: str, value: object) -> Triple:
    """Return a value as three finite floats.

    Parameters
    ----------
    shape, name : of the shape and of its parameter, for the message
    value : the value

    Returns
    -------
    three floats

    Raises
    ------
    InputError
        When it is not three finite numbers.
    """
    array = np.asarray(value, dtype=np.float64)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise InputError(f"{shape} {name} must be three finite numbers, got {value!r}")
    return (float(array[0]), float(array[1]), float(array[2]))


def checked_axis(shape: str, name: str, value: object) -> Triple:
    """Return a value as a direction.

    Parameters
    ----------
    shape, name : of the shape and of its parameter, for the message
    value : the value

    Returns
    -------
    three floats

    Raises
    ------
    InputError
        When it is not three finite numbers, or zero.
    """
    triple = checked_triple(shape, name, value)
    if not any(triple):
        raise InputError(f"{shape} {name} must not be the zero vector")
    return triple


def checked_lengths(shape: str, name: str, values: tuple[float, ...]) -> None:
    """Refuse lengths that are not positive, finite, and within 1e-9 .. 1e9 mm, where the local map stays exact.

    Parameters
    ----------
    shape, name : of the shape and of its parameter, for the message
    values : lengths [mm]

    Raises
    ------
    InputError
        When a length is out of range.
    """
    if not all(1e-9 <= value <= 1e9 for value in values) or prod(values) == 0:
        shown = values[0] if len(set(values)) == 1 else values
        raise InputError(f"{shape} {name} must be positive and finite [mm], got {shown!r}")
