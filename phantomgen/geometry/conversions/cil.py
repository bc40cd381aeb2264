"""CIL's acquisition geometries: vectors of every view, or one pose of a scan about the z axis and its angles.

Panels have ``origin='top-left'``: then `direction_y` points upwards, rows count down and columns to the right, as ours.
Data are (channel, projection or angle, vertical, horizontal), volumes (channel, z, y, x).

CIL turns the object clockwise, and puts the volume's axes where the ray from the source to the panel's centre runs
along y: a panel that is shifted along its columns changes the angles of `CilCircle`.

References
----------
.. [1] https://github.com/TomographicImaging/CIL, cil/framework/acquisition_geometry.py.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.conversions.panel_axes import geometry_of, refuse_parallel, right_angled_steps
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry, VectorPerView
from spectra.errors import GeometryError

_SAME = 1e-6  # of the distance to the panel; views of one scan may differ by so much once their angle is taken off
Vector = Float[np.ndarray, "3"]


@dataclass(frozen=True, eq=False)
class CilFlex:
    """Arguments of ``AcquisitionGeometry.create_Cone3D_Flex``, and the panel.

    Parameters
    ----------
    source_position_set, detector_position_set : of each view [mm]
    detector_direction_x_set, detector_direction_y_set : unit vectors along columns, and upwards
    panel : the pixel grid; for ``set_panel((columns, rows), (column pitch, row pitch), origin='top-left')``
    """

    source_position_set: VectorPerView
    detector_position_set: VectorPerView
    detector_direction_x_set: VectorPerView
    detector_direction_y_set: VectorPerView
    panel: Panel


@dataclass(frozen=True, eq=False)
class CilCircle:
    """Arguments of ``create_Cone3D`` or ``create_Parallel3D`` and of ``set_angles``, and the panel.

    Parameters
    ----------
    source_position : source at angle 0 [mm]; None in a parallel beam
    ray_direction : unit vector along the rays at angle 0; None in a cone beam
    detector_position : centre of the panel [mm]
    detector_direction_x, detector_direction_y : unit vectors along columns, and upwards
    angles : of the object [degree]
    panel : the pixel grid
    """

    source_position: Vector | None
    ray_direction: Vector | None
    detector_position: Vector
    detector_direction_x: Vector
    detector_direction_y: Vector
    angles: Float[np.ndarray, " view"]
    panel: Panel


def to_cil_flex(geometry: Geometry) -> CilFlex:
    """Convert any poses of a cone beam to CIL's vectors.

    Parameters
    ----------
    geometry : poses

    Returns
    -------
    the vectors

    Raises
    ------
    GeometryError
        When the beam is parallel, or pixels are no rectangles of one size.
    """
    refuse_parallel(geometry, "CIL's Cone3D_Flex")
    column, row = right_angled_steps(geometry, "CIL")
    return CilFlex(geometry.source, geometry.panel_center, column, -row, geometry.panel)


def from_cil_flex(flex: CilFlex) -> Geometry:
    """Convert CIL's vectors to poses.

    Parameters
    ----------
    flex : the vectors

    Returns
    -------
    the poses
    """
    panel = flex.panel
    return geometry_of(
        flex.detector_position_set,
        panel.column_pitch * flex.detector_direction_x_set,
        -panel.row_pitch * flex.detector_direction_y_set,
        (panel.rows, panel.columns),
        source=flex.source_position_set,
    )


def to_cil_circle(geometry: Geometry) -> CilCircle:
    """Convert a scan about the z axis to one pose and its angles, which CIL's filtered back-projection needs.

    Parameters
    ----------
    geometry : poses

    Returns
    -------
    the pose and the angles

    Raises
    ------
    GeometryError
        When views differ by more than a turn about the z axis, or pixels are no rectangles of one size.
    """
    column, row = right_angled_steps(geometry, "CIL")
    beam = geometry.source if geometry.ray_direction is None else -geometry.ray_direction
    if np.hypot(beam[:, 0], beam[:, 1]).min(initial=np.inf) < 1e-9:
        raise GeometryError("CIL's circular scan needs rays across the z axis, and those of a view run along it")
    turns = np.arctan2(beam[:, 1], beam[:, 0]) + np.pi / 2
    nominal = [_turned(v, -turns) for v in (beam, geometry.panel_center, column, -row)]
    size = float(np.abs(geometry.panel_center).max()) + (0.0 if geometry.is_parallel else float(np.abs(beam).max()))
    units = (1.0 if geometry.is_parallel else size, size, 1.0, 1.0)
    for what, vectors, unit in zip(("beam", "panel", "columns", "rows"), nominal, units, strict=True):
        apart = np.abs(vectors - vectors[0]).max(axis=1) / unit
        if apart.max() > _SAME:
            view = int(apart.argmax())
            raise GeometryError(
                f"CIL's circular scan needs views that differ by a turn about the z axis only: the {what} of view "
                f"{view} is not that of view 0 ({geometry.kind} geometry); Cone3D_Flex takes any cone beam"
            )
    first, center, across, up = (vectors[0] for vectors in nominal)
    ray = center - first
    bend = 0.0 if geometry.is_parallel else np.arctan2(ray[0], ray[1])
    return CilCircle(
        source_position=None if geometry.is_parallel else first,
        ray_direction=-first if geometry.is_parallel else None,
        detector_position=center,
        detector_direction_x=across,
        detector_direction_y=up,
        angles=np.rad2deg(bend - turns),
        panel=geometry.panel,
    )


def from_cil_circle(circle: CilCircle) -> Geometry:
    """Convert one pose of CIL and its angles to poses.

    Parameters
    ----------
    circle : with a source or parallel rays in the plane of y and z at angle 0, and the axis through the origin

    Returns
    -------
    the poses, with the angles of the source counter-clockwise from +x

    Raises
    ------
    GeometryError
        When the source is beside the plane of y and z, or the poses are impossible.
    """
    first = circle.ray_direction if circle.source_position is None else circle.source_position
    if first is None or abs(first[0]) > 1e-9 * np.linalg.norm(first):
        raise GeometryError(f"CIL's scan needs a source or rays with x = 0 at angle 0, got {first}")
    ray = circle.detector_position - first
    bend = 0.0 if circle.source_position is None else np.arctan2(ray[0], ray[1])
    turns = bend - np.deg2rad(circle.angles)
    count, panel = len(turns), circle.panel

    def everywhere(vector: Vector) -> VectorPerView:
        return _turned(np.tile(vector, (count, 1)), turns)

    steps = (
        everywhere(circle.detector_position),
        everywhere(panel.column_pitch * circle.detector_direction_x),
        everywhere(-panel.row_pitch * circle.detector_direction_y),
    )
    size, angles = (panel.rows, panel.columns), turns - np.pi / 2
    if circle.source_position is None:
        return geometry_of(*steps, size, ray_direction=everywhere(first), angles=angles)
    return geometry_of(*steps, size, source=everywhere(first), angles=angles)


def _turned(vectors: VectorPerView, angles: Float[np.ndarray, " view"]) -> VectorPerView:
    """Turn each vector about the z axis."""
    x, y, z = vectors.T
    return np.stack([np.cos(angles) * x - np.sin(angles) * y, np.sin(angles) * x + np.cos(angles) * y, z], axis=1)
