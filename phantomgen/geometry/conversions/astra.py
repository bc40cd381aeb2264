"""ASTRA's geometries of vectors, ``cone_vec`` and ``parallel3d_vec``.

Twelve numbers per view (x, y, z): source, or direction of the rays of a parallel beam; centre of the panel; step to the
next column; step to the next row. These are our four vectors. ASTRA's projections are (row, view, column), its volumes
(z, y, x). ``astra.create_proj_geom(kind, rows, columns, vectors)`` takes what `to_astra` returns.
"""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.conversions.panel_axes import geometry_of, refuse_curved
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from spectra.errors import GeometryError


class AstraGeometry(NamedTuple):
    """Arguments of ``astra.create_proj_geom``, in its order.

    Parameters
    ----------
    kind : ``cone_vec`` or ``parallel3d_vec``
    rows, columns : size of the panel
    vectors : twelve numbers per view [mm]
    """

    kind: Literal["cone_vec", "parallel3d_vec"]
    rows: int
    columns: int
    vectors: Float[np.ndarray, "view 12"]


def to_astra(geometry: Geometry) -> AstraGeometry:
    """Convert poses to ASTRA's vectors.

    Parameters
    ----------
    geometry : poses

    Returns
    -------
    arguments of ``astra.create_proj_geom``

    Raises
    ------
    GeometryError
        When the panel is curved.
    """
    refuse_curved(geometry, "ASTRA")
    first = geometry.source if geometry.ray_direction is None else geometry.ray_direction
    vectors = np.hstack([first, geometry.panel_center, geometry.column_step, geometry.row_step])
    panel = geometry.panel
    return AstraGeometry("parallel3d_vec" if geometry.is_parallel else "cone_vec", panel.rows, panel.columns, vectors)


def from_astra(kind: str, rows: int, columns: int, vectors: Float[np.ndarray, "view 12"]) -> Geometry:
    """Convert ASTRA's vectors to poses.

    Parameters
    ----------
    kind : ``cone_vec`` or ``parallel3d_vec``
    rows, columns : size of the panel
    vectors : twelve numbers per view [mm]

    Returns
    -------
    the poses

    Raises
    ------
    GeometryError
        When the kind is another one, there are not twelve numbers per view, or the pitch differs between views.
    """
    vectors = np.asarray(vectors, dtype=np.float64)
    if vectors.ndim != 2 or vectors.shape[1] != 12:
        raise GeometryError(f"ASTRA's {kind} needs vectors of twelve numbers per view, got shape {vectors.shape}")
    first, center, column, row = (vectors[:, i : i + 3] for i in range(0, 12, 3))
    if kind == "cone_vec":
        return geometry_of(center, column, row, (rows, columns), source=first)
    if kind == "parallel3d_vec":
        return geometry_of(center, column, row, (rows, columns), ray_direction=first)
    raise GeometryError(f"ASTRA's geometry must be cone_vec or parallel3d_vec, got {kind!r}: astra.geom_2vec converts")


def to_astra_volume(grid: Grid) -> tuple[float, ...]:
    """Convert a grid to the arguments of ``astra.create_vol_geom``.

    Parameters
    ----------
    grid : voxels

    Returns
    -------
    number of voxels along y, x, z, then outer edges: least and greatest x, y, z [mm]
    """
    (nz, ny, nx), edges = grid.shape, []
    for n, spacing, origin in zip(grid.shape[::-1], grid.spacing[::-1], grid.origin[::-1], strict=True):
        edges += [origin - spacing / 2, origin + (n - 0.5) * spacing]
    return (ny, nx, nz, *edges)
