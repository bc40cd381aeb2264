"""Objects as rows of unit primitives, as the operators take them.

An object is a union of terms, and a term is what lies inside all of some primitives and outside some others. Rows of a
term follow each other, and so do the terms of an object; later objects override earlier ones.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int64

from phantomgen.ops.mesh import Surfaces
from phantomgen.ops.primitives import BALL, HALFSPACE, MESH, TORUS
from phantomgen.ops.voxel_maps import VoxelMaps
from spectra.errors import InputError


class Solids(NamedTuple):
    """Rows of primitives.

    Parameters
    ----------
    kinds : code of `phantomgen.ops.primitives`
    locals_ : map from world [mm] to local coordinates
    materials : index of the material of the row's object
    tubes : radius of the tube of a torus in local coordinates, else 0
    owners : first row of the object that a row belongs to
    terms : first row of the term that a row belongs to
    inside : whether the term lies inside the primitive, or outside
    meshes : which of the surfaces a row of kind `MESH` is, else -1
    surfaces : closed triangle meshes, None where there are none
    voxels : voxel maps, None where there are none; a map is a row of kind `BOX`, the first one of its object
    """

    kinds: Int64[np.ndarray, " row"]
    locals_: Float[np.ndarray, "row 3 4"]
    materials: Int64[np.ndarray, " row"]
    tubes: Float[np.ndarray, " row"]
    owners: Int64[np.ndarray, " row"]
    terms: Int64[np.ndarray, " row"]
    inside: Bool[np.ndarray, " row"]
    meshes: Int64[np.ndarray, " row"]
    surfaces: Surfaces | None = None
    voxels: VoxelMaps | None = None

    @classmethod
    def plain(
        cls,
        kinds: Int64[np.ndarray, " row"],
        locals_: Float[np.ndarray, "row 3 4"],
        materials: Int64[np.ndarray, " row"],
    ) -> "Solids":
        """Create objects of one primitive each.

        Parameters
        ----------
        kinds, locals_, materials : as in `Solids`

        Returns
        -------
        the objects
        """
        rows = np.arange(len(kinds))
        whole = np.ones(len(rows), np.bool_)
        return cls(kinds, locals_, materials, np.zeros(len(rows)), rows, rows, whole, np.full(len(rows), -1))

    @property
    def rows(self) -> int:
        """Number of primitives."""
        return len(self.kinds)

    @property
    def balls(self) -> Float[np.ndarray, "row 4"]:
        """Balls around all primitives: centre [mm], and radius squared [mm^2], infinite for a half-space."""
        center, axes = half_axes(self.locals_)
        radius = np.linalg.norm(axes, ord=2, axis=(1, 2)) * np.where(self.kinds == BALL, 1.0, np.sqrt(3.0))
        return np.column_stack([center, np.where(self.kinds == HALFSPACE, np.inf, radius**2)])

    def term_bounds(self, bounds: Float[np.ndarray, "row limit"]) -> Float[np.ndarray, "row limit"]:
        """Compute the bounds of each row's term: the intersection of those of the primitives that it lies inside.

        Parameters
        ----------
        bounds : of each row, lowest and highest values of one coordinate or of several in turn

        Returns
        -------
        bounds of the terms; lowest values above highest ones where a term is empty
        """
        signs = np.resize([1.0, -1.0], bounds.shape[1])  # the largest of all lowest values, the smallest of the highest
        joint = np.full_like(bounds, -np.inf)
        np.maximum.at(joint, self.terms[self.inside], (signs * bounds)[self.inside])
        return signs * joint[self.terms]

    def checked(self, count: int, background: int) -> "Solids":
        """Check the arrays, and convert them to the types of the kernels.

        Parameters
        ----------
        count : number of materials
        background : material outside all shapes, -1 for none

        Returns
        -------
        the objects

        Raises
        ------
        InputError
            When the arrays would make a kernel write outside of them.
        """
        rows = self.rows
        integers = [
            np.ascontiguousarray(a, dtype=np.int64)
            for a in (self.kinds, self.materials, self.owners, self.terms, self.meshes)
        ]
        numbers = [np.ascontiguousarray(a, dtype=np.float64) for a in (self.locals_, self.tubes)]
        inside = np.ascontiguousarray(self.inside, dtype=np.bool_)
        kinds, materials, owners, terms, meshes = integers
        if numbers[0].shape != (rows, 3, 4) or any(a.shape != (rows,) for a in (*integers, numbers[1], inside)):
            raise InputError(
                f"{rows} shapes need maps (shape, 3, 4) and one material each, "
                f"got {numbers[0].shape} and {materials.shape}"
            )
        if rows and (materials.min() < 0 or materials.max() >= count):
            raise InputError(f"material indices must lie in 0..{count - 1}, got {materials.min()}..{materials.max()}")
        if not -1 <= background < count:
            raise InputError(f"background must be -1 or a material index below {count}, got {background}")
        bounded = np.zeros(rows, np.bool_)
        bounded[terms[inside & (kinds != HALFSPACE)]] = True
        if not bounded[terms].all():
            raise InputError("every part of a shape must lie inside something bounded")
        if not ((numbers[1] > 0) & (numbers[1] < 0.5))[kinds == TORUS].all():
            raise InputError("the tube of a torus must be thinner than its ring")
        known = 0 if self.surfaces is None else len(self.surfaces.parts) - 1
        if not ((meshes >= 0) & (meshes < known))[kinds == MESH].all():
            raise InputError(f"meshes must be numbered 0..{known - 1}, got {meshes[kinds == MESH].tolist()}")
        voxels = None if self.voxels is None else self.voxels.checked(rows, count)
        return Solids(kinds, numbers[0], materials, numbers[1], owners, terms, inside, meshes, self.surfaces, voxels)


def half_axes(
    locals_: Float[np.ndarray, "row 3 4"],
) -> tuple[Float[np.ndarray, "row 3"], Float[np.ndarray, "row 3 3"]]:
    """Compute centres and half axes of the cubes -1 .. 1 of local systems; without meaning for half-spaces.

    Parameters
    ----------
    locals_ : maps from world [mm] to local coordinates

    Returns
    -------
    centres (x, y, z) [mm], and half axes as columns [mm]
    """
    x, y, z = locals_[:, 0, :3], locals_[:, 1, :3], locals_[:, 2, :3]
    axes = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=2)
    size = (x * axes[:, :, 0]).sum(axis=1)
    axes /= np.where(size == 0, 1.0, size)[:, None, None]
    return -(axes @ locals_[:, :, 3:])[:, :, 0], axes
