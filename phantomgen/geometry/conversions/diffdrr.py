"""DiffDRR's cameras: a pose and a calibration matrix per view.

``drr(RigidTransform(pose), calibration=RigidTransform(calibration))`` of a ``DRR`` whose subject has
``orientation=None``, which keeps the axes of the scan, and with ``reverse_x_axis=True``, the default. The source is the
origin of the camera; its z axis meets the panel at right angles, x and y run against columns and rows. Images are
(view, channel, row, column), volumes (x, y, z).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.conversions.panel_axes import geometry_of, refuse_parallel, right_angled_steps
from phantomgen.geometry.poses import Geometry


class DiffDrrCameras(NamedTuple):
    """Cameras of all views.

    Parameters
    ----------
    pose : from coordinates of the camera to those of the scan [mm]
    calibration : from pixels around the panel's centre, on a plane at 1, to coordinates of the camera [mm]
    height, width : number of rows and columns
    """

    pose: Float[np.ndarray, "view 4 4"]
    calibration: Float[np.ndarray, "view 4 4"]
    height: int
    width: int


def to_diffdrr(geometry: Geometry) -> DiffDrrCameras:
    """Convert poses to DiffDRR's cameras.

    Parameters
    ----------
    geometry : poses

    Returns
    -------
    the cameras

    Raises
    ------
    GeometryError
        When the beam is parallel, or pixels are no rectangles of one size.
    """
    refuse_parallel(geometry, "DiffDRR")
    column, row = right_angled_steps(geometry, "DiffDRR")
    axes = np.stack([-column, -row, np.cross(column, row)], axis=2)
    pose, calibration = np.tile(np.eye(4), (2, len(geometry), 1, 1))
    pose[:, :3, :3], pose[:, :3, 3] = axes, geometry.source
    x0, y0, sdd = np.einsum("vji,vj->iv", axes, geometry.panel_center - geometry.source)
    calibration[:, 0, 0], calibration[:, 1, 1] = geometry.panel.column_pitch, geometry.panel.row_pitch
    calibration[:, 0, 3], calibration[:, 1, 3], calibration[:, 2, 2] = x0, y0, sdd
    return DiffDrrCameras(pose, calibration, geometry.panel.rows, geometry.panel.columns)


def from_diffdrr(cameras: DiffDrrCameras) -> Geometry:
    """Convert DiffDRR's cameras to poses.

    Parameters
    ----------
    cameras : with ``reverse_x_axis=True``; a pose that a subject's orientation changes must include that

    Returns
    -------
    the poses

    Raises
    ------
    GeometryError
        When the pitch differs between views.
    """
    turn, source = cameras.pose[:, :3, :3], cameras.pose[:, :3, 3]
    matrix = cameras.calibration
    local = np.stack([matrix[:, 0, 3], matrix[:, 1, 3], matrix[:, 2, 2] + matrix[:, 2, 3]], axis=1)
    center = source + np.einsum("vij,vj->vi", turn, local)
    column, row = -matrix[:, :1, 0] * turn[:, :, 0], -matrix[:, 1:2, 1] * turn[:, :, 1]
    return geometry_of(center, column, row, (cameras.height, cameras.width), source=source)
