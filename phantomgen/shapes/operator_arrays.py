"""Arrays for the operators from an ordered list of shapes with their materials."""

from collections.abc import Iterable

import numpy as np

from phantomgen.ops.mesh import Surfaces
from phantomgen.ops.solids import Solids
from phantomgen.ops.voxel_maps import VoxelMap, VoxelMaps
from phantomgen.shapes.base import Part, Shape
from spectra.errors import InputError


def solids_of(objects: Iterable[tuple[Shape, int | tuple[int, ...]]]) -> Solids:
    """Create the arrays of (shape, material index) pairs; a later shape owns what it shares with an earlier one.

    A voxel map comes with the material of each of its parts.

    Parameters
    ----------
    objects : shapes with the index of their material, or of each part of a voxel map

    Returns
    -------
    arrays for the operators

    Raises
    ------
    InputError
        When a material index is negative.
    """
    parts: list[Part] = []
    maps: list[tuple[VoxelMap, tuple[int, ...]] | None] = []
    roles: list[tuple[int, int, int]] = []
    for shape, material in objects:
        named = material if isinstance(material, tuple) else (material,)
        if min(named, default=0) < 0:
            raise InputError(f"material indices must not be negative, got {material}")
        owner = len(parts)
        for term in shape.terms:
            first = len(parts)
            parts += term
            roles += [((*named, 0)[0], owner, first)] * len(term)
            maps += [None if part.voxels is None else (part.voxels, named) for part in term]
    materials, owners, terms = np.array(roles, dtype=np.int64).reshape(-1, 3).T
    meshes = np.array([part.surface is not None for part in parts], dtype=np.bool_)
    surfaces = [part.surface for part in parts if part.surface is not None]
    return Solids(
        kinds=np.array([part.kind for part in parts], dtype=np.int64),
        locals_=np.array([part.local for part in parts], dtype=np.float64).reshape(-1, 3, 4),
        materials=materials,
        tubes=np.array([part.tube for part in parts], dtype=np.float64),
        owners=owners,
        terms=terms,
        inside=np.array([part.inside for part in parts], dtype=np.bool_),
        meshes=np.where(meshes, np.cumsum(meshes) - 1, -1),
        surfaces=Surfaces.of(surfaces) if surfaces else None,
        voxels=VoxelMaps.of(maps),
    )
