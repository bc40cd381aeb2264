"""Poses of a fixed source and panel around a sample that turns: what most scanners state."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Shaped

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.importers.scans.raw_scan import Image
from phantomgen.importers.scans.stated import Stated
from spectra.errors import GeometryError


@dataclass(frozen=True)
class Turntable:
    """Source and panel in the frame of a rotation axis, for the source at angle 0.

    That frame has x from the axis towards the source, z along the axis, and y along the columns of the panel.

    Parameters
    ----------
    sod, sdd : distance from the source to the axis and to the panel [mm]; sod 0 for a parallel beam, whose panel is at
        `sdd` from the axis
    panel : the pixel grid; rows count downwards
    source_y : of the source [mm]
    panel_y, panel_z : of the panel's centre [mm]
    axis : direction of the rotation axis in this frame, (0, 0, 1) where it is upright
    """

    sod: float
    sdd: float
    panel: Panel
    source_y: float = 0.0
    panel_y: float = 0.0
    panel_z: float = 0.0
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def views(self, angles: Float[np.ndarray, " view"], z: Float[np.ndarray, " view"] | float = 0.0) -> Geometry:
        """Create the poses of all views.

        Parameters
        ----------
        angles : of the source, counter-clockwise from +x [degree]
        z : height of the source and the panel over the sample [mm]

        Returns
        -------
        the poses

        Raises
        ------
        GeometryError
            When the axis does not lie between source and panel.
        """
        if not (0 <= self.sod < self.sdd):
            raise GeometryError(f"a scan needs 0 < sod < sdd, got sod {self.sod:g} mm and sdd {self.sdd:g} mm")
        turn = _upright(np.array(self.axis, dtype=np.float64))
        radians = np.deg2rad(np.asarray(angles, dtype=np.float64))
        c, s, zero, one = np.cos(radians), np.sin(radians), np.zeros_like(radians), np.ones_like(radians)
        spin = np.stack([np.stack([c, -s, zero], 1), np.stack([s, c, zero], 1), np.stack([zero, zero, one], 1)], 1)
        rise = np.stack([zero, zero, np.broadcast_to(np.asarray(z, dtype=np.float64), radians.shape)], 1)

        def turned(vector: tuple[float, float, float]) -> Float[np.ndarray, "view 3"]:
            return spin @ (turn @ np.array(vector, dtype=np.float64))

        center = turned((self.sod - self.sdd, self.panel_y, self.panel_z)) + rise
        steps = turned((0, self.panel.column_pitch, 0)), turned((0, 0, -self.panel.row_pitch))
        if self.sod == 0:
            return Geometry.parallel(turned((-1.0, 0.0, 0.0)), center, *steps, self.panel, radians)
        source = turned((self.sod, self.source_y, 0)) + rise
        kind = "helical" if np.ptp(rise[:, 2]) > 0 else "circular" if self.axis == (0, 0, 1) else "free"
        return Geometry(source, center, *steps, self.panel, radians, kind)

    def with_axis_at(self, column: float | None) -> "Turntable":
        """Shift the panel so that the axis is projected to a column.

        Parameters
        ----------
        column : the column in the order of the panel, counted from 0, pixel centres are integers; None leaves the panel
            where it is

        Returns
        -------
        the shifted one
        """
        if column is None:
            return self
        middle = (self.panel.columns - 1) / 2
        return replace(self, source_y=0.0, panel_y=(middle - column) * self.panel.column_pitch)


def stated_axis(stated: Stated, columns: int, reverse: bool = False) -> float | None:
    """Return the column of the axis, which a user states as it is stored, in the order of the panel.

    Parameters
    ----------
    stated : facts that the user states
    columns : of the panel
    reverse : whether the format stores columns in the opposite order

    Returns
    -------
    the column; None where it is not stated
    """
    column = stated.axis_column
    return column if column is None or stated.mirror == reverse else columns - 1 - column


def turning(angles: Float[np.ndarray, " view"], stated: Stated) -> Float[np.ndarray, " view"]:
    """Turn angles the other way round where the user says so.

    Parameters
    ----------
    angles : of the source [degree]
    stated : facts that the user states

    Returns
    -------
    angles of the source [degree]
    """
    return -angles if stated.reverse else angles


def as_stored(image: Callable[[int], Image], stated: Stated) -> Callable[[int], Image]:
    """Reverse columns and rows where the user says that they are stored in the opposite order.

    Parameters
    ----------
    image : function that reads a view
    stated : facts that the user states

    Returns
    -------
    such a function
    """
    return lambda view: in_order(image(view), stated)


def in_order(
    images: Shaped[np.ndarray, "*before row column"], stated: Stated
) -> Shaped[np.ndarray, "*before row column"]:
    """Reverse columns and rows of images where the user says that they are stored in the opposite order.

    Parameters
    ----------
    images : (..., row, column)
    stated : facts that the user states

    Returns
    -------
    the images
    """
    return images[..., :: -1 if stated.flip_rows else 1, :: -1 if stated.mirror else 1]


def _upright(axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Smallest rotation that takes an axis to z."""
    a = axis / np.linalg.norm(axis)
    x, y, z = a
    if z < -0.99:
        raise GeometryError(f"a rotation axis must point upwards, got {axis.tolist()}")
    cross = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    return np.eye(3) + cross + cross @ cross / (1 + z)
