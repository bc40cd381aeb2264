"""Poses of a part of a panel, of a panel with larger pixels, and of one that was moved in its own plane."""

from dataclasses import replace

import numpy as np

from phantomgen.geometry.curved_panel import shifted_along
from phantomgen.geometry.poses import Geometry
from spectra.errors import GeometryError


def smaller_panel(geometry: Geometry, columns: slice, factor: int, rows: slice | None = None) -> Geometry:
    """Return the poses of some of the columns and rows of a panel, with pixels summed.

    Parameters
    ----------
    geometry : poses of the whole panel
    columns : those that are left
    factor : pixels along each side that are summed; divides what is left
    rows : those that are left, all by default

    Returns
    -------
    poses whose pixel centres are the middles of the old pixels that each consists of

    Raises
    ------
    GeometryError
        When columns of a curved panel are left out, or pixels do not divide.
    """
    panel = geometry.panel
    rows = rows or slice(0, panel.rows)
    if panel.curvature is not None and (columns.start, columns.stop) != (0, panel.columns):
        raise GeometryError("columns of a curved panel cannot be left out, only rows")
    right = (columns.start + columns.stop - panel.columns) / 2
    down = (rows.start + rows.stop - panel.rows) / 2
    cropped = replace(
        geometry,
        panel_center=geometry.panel_center + right * geometry.column_step + down * geometry.row_step,
        panel=replace(panel, rows=rows.stop - rows.start, columns=columns.stop - columns.start),
    )
    return _same_rays(geometry, cropped).binned(factor)


def moved_panel(geometry: Geometry, shift: float, turn: float = 0.0, down: float = 0.0) -> Geometry:
    """Move the panel in its plane and turn it there, the source staying where it is.

    Parameters
    ----------
    geometry : poses
    shift : by so many columns
    turn : about the centre of the panel, from its columns towards its rows [degree]
    down : by so many rows

    Returns
    -------
    moved poses
    """
    c, s = np.cos(np.deg2rad(turn)), np.sin(np.deg2rad(turn))
    aside = shifted_along(geometry, shift * geometry.panel.column_pitch)
    normal = aside.normals() if turn else np.zeros_like(geometry.column_step)
    moved = replace(
        aside,
        panel_center=aside.panel_center + down * aside.row_step,
        column_step=c * aside.column_step + s * np.cross(normal, aside.column_step),
        row_step=c * aside.row_step + s * np.cross(normal, aside.row_step),
    )
    return _same_rays(geometry, moved)


def _same_rays(geometry: Geometry, moved: Geometry) -> Geometry:
    """Geometry with the panel of `moved`; the far source of a parallel beam moves along."""
    if geometry.ray_direction is None:
        return moved
    return replace(moved, source=geometry.source + moved.panel_center - geometry.panel_center)
