"""tomosipo's geometries of vectors: our vectors in the order (z, y, x).

``tomosipo.cone_vec(**arguments)`` and ``tomosipo.parallel_vec(**arguments)`` take what `to_tomosipo` returns.
Projections are (row, view, column), volumes (z, y, x), as those of ASTRA.
"""

from typing import Any

import numpy as np

from phantomgen.geometry.conversions.panel_axes import geometry_of, refuse_curved
from phantomgen.geometry.poses import Geometry, VectorPerView
from spectra.errors import GeometryError


def to_tomosipo(geometry: Geometry) -> dict[str, Any]:
    """Convert poses to the arguments of ``tomosipo.cone_vec``, or of ``tomosipo.parallel_vec`` for a parallel beam.

    Parameters
    ----------
    geometry : poses

    Returns
    -------
    ``shape`` (rows, columns), ``src_pos`` or ``ray_dir``, ``det_pos``, ``det_v`` and ``det_u``

    Raises
    ------
    GeometryError
        When the panel is curved.
    """
    refuse_curved(geometry, "tomosipo")
    first = {"src_pos": geometry.source} if geometry.ray_direction is None else {"ray_dir": geometry.ray_direction}
    vectors = {**first, "det_pos": geometry.panel_center, "det_v": geometry.row_step, "det_u": geometry.column_step}
    turned = {name: np.ascontiguousarray(value[:, ::-1]) for name, value in vectors.items()}
    return {"shape": (geometry.panel.rows, geometry.panel.columns), **turned}


def from_tomosipo(
    shape: tuple[int, int],
    det_pos: VectorPerView,
    det_v: VectorPerView,
    det_u: VectorPerView,
    src_pos: VectorPerView | None = None,
    ray_dir: VectorPerView | None = None,
) -> Geometry:
    """Convert vectors of tomosipo to poses.

    Parameters
    ----------
    shape : number of rows and of columns
    det_pos, det_v, det_u : centre of the panel, steps to the next row and column, (z, y, x) [mm]
    src_pos : source points (z, y, x) [mm], of a cone beam
    ray_dir : directions of the rays (z, y, x), of a parallel beam

    Returns
    -------
    the poses

    Raises
    ------
    GeometryError
        When there are both or neither of source and direction, or the pitch differs between views.
    """
    if (src_pos is None) == (ray_dir is None):
        raise GeometryError("tomosipo's vectors need either src_pos, of a cone beam, or ray_dir, of a parallel beam")
    center, column, row = (np.asarray(v, dtype=np.float64)[:, ::-1] for v in (det_pos, det_u, det_v))
    if src_pos is not None:
        return geometry_of(center, column, row, shape, source=np.asarray(src_pos, dtype=np.float64)[:, ::-1])
    return geometry_of(center, column, row, shape, ray_direction=np.asarray(ray_dir, dtype=np.float64)[:, ::-1])
