"""LEAP's modular beam: source, centre and unit axes of one flat module per view.

``leap.set_modularbeam(*to_leap(geometry))`` after a conversion to float32. Projections are (view, row, column), volumes
(z, y, x) of cubes.

Where rows go up in all views, LEAP 1.26 takes the beam for an upright one: it filters projections of such beams only,
but on a CPU it projects as if panels were not shifted (12.5 mm in tests). Rows that go down, as those of scans here,
are projected as they are.

References
----------
.. [1] https://github.com/LLNL/LEAP, src/parameters.cpp (set_sourcesAndModules).
"""

from typing import NamedTuple

import numpy as np

from phantomgen.geometry.conversions.panel_axes import geometry_of, refuse_parallel, right_angled_steps
from phantomgen.geometry.poses import Geometry, VectorPerView
from phantomgen.geometry.voxel_grid import Grid
from spectra.errors import GeometryError

_UPRIGHT = 0.9961  # cosine of the angle between the panel and z from which on LEAP takes it for upright


class LeapGeometry(NamedTuple):
    """Arguments of ``set_modularbeam``, in its order and under its names.

    Parameters
    ----------
    numAngles, numRows, numCols : number of views, rows and columns
    pixelHeight, pixelWidth : pitch of rows and of columns [mm]
    sourcePositions, moduleCenters : (x, y, z) of each view [mm]
    rowVectors, colVectors : unit vectors to the next row and to the next column
    """

    numAngles: int
    numRows: int
    numCols: int
    pixelHeight: float
    pixelWidth: float
    sourcePositions: VectorPerView
    moduleCenters: VectorPerView
    rowVectors: VectorPerView
    colVectors: VectorPerView


def to_leap(geometry: Geometry) -> LeapGeometry:
    """Convert poses to LEAP's modular beam.

    Parameters
    ----------
    geometry : poses

    Returns
    -------
    arguments of ``set_modularbeam``

    Raises
    ------
    GeometryError
        When the beam is parallel, pixels are no rectangles of one size, or rows go up in all views.
    """
    refuse_parallel(geometry, "LEAP's modular beam")
    column, row = right_angled_steps(geometry, "LEAP's modular beam")
    if len(row) and (row[:, 2] >= _UPRIGHT).all():
        raise GeometryError("LEAP drops the shift of panels whose rows go up: turn them by 180 degrees, or flip rows")
    panel = geometry.panel
    return LeapGeometry(
        len(geometry), panel.rows, panel.columns, panel.row_pitch, panel.column_pitch,
        geometry.source, geometry.panel_center, row, column,
    )  # fmt: skip


def from_leap(leap: LeapGeometry) -> Geometry:
    """Convert LEAP's modular beam to poses.

    Parameters
    ----------
    leap : arguments of ``set_modularbeam``

    Returns
    -------
    the poses
    """
    source, center, row, column = (np.asarray(vectors, dtype=np.float64) for vectors in leap[5:])
    size = leap.numRows, leap.numCols
    return geometry_of(center, leap.pixelWidth * column, leap.pixelHeight * row, size, source=source)


def to_leap_volume(grid: Grid) -> tuple[float, ...]:
    """Convert a grid to the arguments of LEAP's ``set_volume``.

    Parameters
    ----------
    grid : voxels

    Returns
    -------
    number of voxels along x, y, z, their width and height, and the centre of the volume x, y, z [mm]

    Raises
    ------
    GeometryError
        When voxels are no cubes; LEAP would take others for cubes.
    """
    (nz, ny, nx), (dz, dy, dx) = grid.shape, grid.spacing
    if max(abs(dx - dy), abs(dx - dz)) > 1e-6 * dx:
        raise GeometryError(
            f"LEAP's modular beam needs cubes as voxels, these have {dx:g} x {dy:g} x {dz:g} mm (x, y, z)"
        )
    center = [o + (n - 1) / 2 * s for n, s, o in zip((nx, ny, nz), (dx, dy, dz), grid.origin[::-1], strict=True)]
    return (nx, ny, nz, dx, dz, *center)
