"""Keys of the pickles that NAF, SAX-NeRF and their successors read; the geometry part of them.

These methods do not agree on the order of `nDetector` and `dDetector` (columns first in NAF's rays, rows first in the
projector that made its data), nor on that of `offDetector`: scans of a panel that is not square, or shifted, are
refused. Lengths are in mm; the readers divide them by 1000, so volumes are in 1/m.

References
----------
.. [1] https://github.com/Ruyi-Zha/naf_cbct, src/dataset/tigre.py.
"""

from typing import Any

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.conversions.panel_axes import refuse_curved
from phantomgen.geometry.conversions.r2_gaussian import from_r2_gaussian, pair_of, to_r2_gaussian, triple_of
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from spectra.errors import GeometryError

_SAME = 1e-6  # relative; pixels that differ by so much along rows and columns count as square


def to_naf(geometry: Geometry, grid: Grid) -> tuple[dict[str, Any], Float[np.ndarray, " view"]]:
    """Convert poses and a grid to keys of the pickle.

    Parameters
    ----------
    geometry : poses
    grid : voxels

    Returns
    -------
    the keys, lengths in mm, triples (x, y, z); angles of the views [rad]

    Raises
    ------
    GeometryError
        When the scan is not circular with a centred, upright, square panel, or the beam is parallel.
    """
    panel = geometry.panel
    refuse_curved(geometry, "NAF's pickle")
    if geometry.is_parallel:
        raise GeometryError("NAF's pickle can only describe cone beams: this beam is parallel")
    if panel.rows != panel.columns or abs(panel.row_pitch - panel.column_pitch) > _SAME * panel.row_pitch:
        raise GeometryError(
            f"NAF's pickle needs a square panel, as its readers differ in what they take for rows: this one has "
            f"{panel.rows} x {panel.columns} pixels of {panel.row_pitch:g} x {panel.column_pitch:g} mm"
        )
    scanner, angles = to_r2_gaussian(geometry, grid, "NAF's pickle")
    size, extent = scanner.pop("sDetector"), scanner.pop("sVoxel")
    scanner["dDetector"] = np.divide(size, scanner["nDetector"]).tolist()
    scanner["dVoxel"] = np.divide(extent, scanner["nVoxel"]).tolist()
    return scanner, angles


def from_naf(values: dict[str, Any], angles: Float[np.ndarray, " view"]) -> tuple[Geometry, Grid]:
    """Convert keys of the pickle to poses and a grid.

    Parameters
    ----------
    values : of the pickle
    angles : of the views [rad]

    Returns
    -------
    the poses and the grid

    Raises
    ------
    GeometryError
        When a key is missing or has another form, or the panel is not square and centred.
    """
    shape, pitch = pair_of(values, "nDetector"), pair_of(values, "dDetector")
    if shape[0] != shape[1] or abs(pitch[0] - pitch[1]) > _SAME * pitch[0]:
        raise GeometryError(
            f"nDetector is {shape} and dDetector {pitch}: of a panel that is not square, readers of this format differ "
            "in what they take for rows"
        )
    count, spacing = triple_of(values, "nVoxel"), triple_of(values, "dVoxel")
    sizes = {"sDetector": np.multiply(shape, pitch).tolist(), "sVoxel": np.multiply(count, spacing).tolist()}
    return from_r2_gaussian({**values, **sizes}, angles)
