"""Primitives as rows of a table, in the form that the kernels of rays take.

All values of a primitive stand side by side in memory, and in few arrays: numba counts references to each array that a
function is handed, which costs more than a chord.
"""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float

from phantomgen.ops.kernel_decorators import inlined
from phantomgen.ops.solids import Solids
from phantomgen.ops.voxel_maps import VoxelMaps

# No unit, relative to the terms of a discriminant; below it, a discriminant is computed anew in twice the precision.
# Above it, the error of a chord is below 1e-12 of the shape: rounding of 1e-16 over the square root of 1e-8.
GRAZING = 1e-8
# Columns. NEED counts the primitives that a term lies inside; it is 0 for a primitive that the term lies outside.
KIND, NEAR, ORIGIN, MAP, OWNER, TERM, ALONE, NEED, SURFACE, MATERIAL = 0, 1, 2, 5, 14, 15, 16, 17, 18, 19
SHIFT, START, WIDTH = 20, 23, 26


class TracedSolids(NamedTuple):
    """Objects as the kernels of rays take them.

    Parameters
    ----------
    table : primitives as `solid_table` makes them
    tubes : as `ring_tubes` makes them
    maps : voxel maps; None without any
    background : material of what no object owns, -1 for none
    """

    table: Float[np.ndarray, "row 26"]
    tubes: Float[np.ndarray, " row"] | None
    maps: VoxelMaps | None
    background: int

    @classmethod
    def of(cls, solids: Solids, background: int) -> "TracedSolids":
        """Arrange objects for the kernels.

        Parameters
        ----------
        solids : the objects, as `Solids.checked` returns them
        background : material outside all shapes, -1 for none

        Returns
        -------
        the arrays; those of the table belong to one thread, as kernels write the origin of rays there
        """
        return cls(solid_table(solids), ring_tubes(solids), solids.voxels, int(background))


def solid_table(solids: Solids) -> Float[np.ndarray, "row 26"]:
    """Create the table of primitives, without the origin of rays.

    Parameters
    ----------
    solids : the objects

    Returns
    -------
    kind, roles, linear map, translation and material of each primitive; columns are named by `KIND` to `START`
    """
    table = np.zeros((solids.rows, WIDTH))
    table[:, KIND], table[:, MATERIAL] = solids.kinds, solids.materials
    table[:, MAP:OWNER] = solids.locals_[:, :, :3].reshape(-1, 9)
    table[:, SHIFT:START] = solids.locals_[:, :, 3]
    table[:, OWNER], table[:, TERM], table[:, SURFACE] = solids.owners, solids.terms, solids.meshes
    needs = np.bincount(solids.terms[solids.inside], minlength=solids.rows)
    table[:, ALONE] = solids.inside & (np.bincount(solids.terms, minlength=solids.rows)[solids.terms] == 1)
    table[:, NEED] = np.where(solids.inside, needs[solids.terms], 0)
    return table


def ring_tubes(solids: Solids) -> Float[np.ndarray, " row"] | None:
    """Return the radius of the tube of each torus.

    Parameters
    ----------
    solids : the objects

    Returns
    -------
    radii in local coordinates, 0 for other primitives; None without tori, whose code is not compiled then
    """
    return solids.tubes if solids.tubes.any() else None


@inlined
@no_type_check
def set_origin(table, s, x, y, z):
    """Write the point where rays begin to a row of the table, in world and in local coordinates.

    Parameters
    ----------
    table : primitives as `solid_table` makes them, written
    s : row
    x, y, z : the point [mm]
    """
    table[s, START], table[s, START + 1], table[s, START + 2] = x, y, z
    distance = 1.0
    for i in range(3):
        at = MAP + 3 * i
        place = table[s, at] * x + table[s, at + 1] * y + table[s, at + 2] * z + table[s, SHIFT + i]
        table[s, ORIGIN + i] = place
        distance += place * place
    table[s, NEAR] = GRAZING * distance
