"""What rays need to know about primitives, as rows of a table.

All of a primitive stands side by side in memory, and in few arrays: numba counts references to each array that a
function is handed, which costs more than a chord.
"""

from typing import no_type_check

import numpy as np
from jaxtyping import Float

from phantomgen.ops.kernel_decorators import inlined
from phantomgen.ops.solids import Solids

# A discriminant is computed anew below this part of its terms; above it, the error of a chord is below 1e-12.
GRAZING = 1e-8
# Columns. NEED counts the primitives that a term lies inside; it is 0 for a primitive that the term lies outside.
KIND, NEAR, ORIGIN, MAP, OWNER, TERM, ALONE, NEED, SURFACE, MATERIAL = 0, 1, 2, 5, 14, 15, 16, 17, 18, 19
SHIFT, START, WIDTH = 20, 23, 26


def solid_table(solids: Solids) -> Float[np.ndarray, "row 26"]:
    """Primitives as rows: kind, material, linear map, roles, translation; the rays' origin is to be filled in."""
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
    """Radius of the tube of each torus, and 0 for other rows; None without tori, whose code is not compiled then."""
    return solids.tubes if solids.tubes.any() else None


@inlined
@no_type_check
def set_origin(table, s, x, y, z):
    """Write the point (x, y, z), where rays begin, to row s, in local coordinates too."""
    table[s, START], table[s, START + 1], table[s, START + 2] = x, y, z
    distance = 1.0
    for i in range(3):
        at = MAP + 3 * i
        place = table[s, at] * x + table[s, at + 1] * y + table[s, at + 2] * z + table[s, SHIFT + i]
        table[s, ORIGIN + i] = place
        distance += place * place
    table[s, NEAR] = GRAZING * distance
