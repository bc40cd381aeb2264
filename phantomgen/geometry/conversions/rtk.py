"""RTK's ``ThreeDCircularProjectionGeometry``: nine numbers per view, or the object itself.

RTK's rotation axis is y: its axes (x, y, z) are our (y, z, x), so that its gantry angle is our angle. Columns run along
its panel's x, rows go up: a stack of projections is ``ours[:, ::-1]``, with the panel's centre at the physical origin.
Its volumes, as arrays, are ``ours.transpose(2, 0, 1)``.

References
----------
.. [1] Rit et al. 2014, doi:10.1088/1742-6596/489/1/012079.
.. [2] https://docs.openrtk.org, Geometry.
"""

from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.conversions.panel_axes import geometry_of, right_angled_steps
from phantomgen.geometry.curved_panel import flat_modules
from phantomgen.geometry.panel import Curvature, Panel
from phantomgen.geometry.poses import Geometry, VectorPerView
from spectra.errors import GeometryError, NotInstalledError

_TO_RTK, _FROM_RTK = [1, 2, 0], [2, 0, 1]  # order of the axes
_CENTRAL = 1e-9  # part of the radius; an axis nearer to the isocentre passes it
_PERPENDICULAR = 1e-6  # largest difference between the ray and the normal of the panel in a parallel beam
Numbers = Float[np.ndarray, " view"]


@dataclass(frozen=True, eq=False)
class RtkGeometry:
    """The nine numbers of each view, under the names of RTK's files; angles in degrees, lengths in mm.

    Parameters
    ----------
    SourceToIsocenterDistance, SourceToDetectorDistance : along the normal of the panel; the latter is 0 in a parallel
        beam, where the former is the distance from the panel to the isocentre
    GantryAngle : about y
    ProjectionOffsetX, ProjectionOffsetY : of the panel's centre from the isocentre's foot, along columns and upwards
    OutOfPlaneAngle, InPlaneAngle : about x, then z
    SourceOffsetX, SourceOffsetY : of the source from the isocentre, along the same
    RadiusCylindricalDetector : of a panel that is curved about an axis along its columns of pixels, 0 for a flat one;
        the normal then passes the isocentre and that axis, and ProjectionOffsetX is the length of the arc from there
    """

    SourceToIsocenterDistance: Numbers
    SourceToDetectorDistance: Numbers
    GantryAngle: Numbers
    ProjectionOffsetX: Numbers
    ProjectionOffsetY: Numbers
    OutOfPlaneAngle: Numbers
    InPlaneAngle: Numbers
    SourceOffsetX: Numbers
    SourceOffsetY: Numbers
    RadiusCylindricalDetector: float = 0.0

    def __len__(self) -> int:
        return len(self.GantryAngle)


def to_rtk(geometry: Geometry) -> RtkGeometry:
    """Convert poses to RTK's nine numbers per view.

    Parameters
    ----------
    geometry : poses

    Returns
    -------
    the numbers; angles from 0 to 360 degrees

    Raises
    ------
    GeometryError
        When pixels are no rectangles of one size, columns and rows are mirrored, or a parallel beam does not meet the
        panel at right angles.

    Notes
    -----
    RTK's curved panel is a smooth cylinder, ours has flat modules that touch it: pixels at the edges of modules lie
    beside it by the square of a module's width over eight radii.
    """
    source, center, across, up = _in_rtk_axes(geometry)
    normal = np.cross(across, up)
    turn = np.stack([across, up, normal], axis=1)
    gantry, outer, inner = _angles(turn)
    offset = np.einsum("vij,vj->vi", turn, center)
    zero = np.zeros(len(geometry))
    if geometry.is_parallel:
        distances, shift = (-offset[:, 2], zero), np.zeros((len(geometry), 3))
    else:
        shift = np.einsum("vij,vj->vi", turn, source)
        distances = shift[:, 2], shift[:, 2] - offset[:, 2]
    curvature = geometry.panel.curvature
    radius = 0.0 if curvature is None else curvature.radius
    return RtkGeometry(*distances, gantry, offset[:, 0], offset[:, 1], outer, inner, shift[:, 0], shift[:, 1], radius)


def from_rtk(rtk: RtkGeometry, panel: Panel) -> Geometry:
    """Convert RTK's nine numbers per view to poses.

    Parameters
    ----------
    rtk : the numbers
    panel : the pixel grid, which RTK keeps with the projections; a flat one gets the radius of `rtk`, and a module for
        each column

    Returns
    -------
    the poses, with the gantry angle as angles

    Raises
    ------
    GeometryError
        When some views are parallel and others are not, or the poses are impossible.
    """
    turn = _rotations(rtk.GantryAngle, rtk.OutOfPlaneAngle, rtk.InPlaneAngle)
    across, up, normal = (np.ascontiguousarray(turn[:, i][:, _FROM_RTK]) for i in range(3))
    parallel = rtk.SourceToDetectorDistance == 0
    if parallel.any() and not parallel.all():
        raise GeometryError(f"view {parallel.argmax()} of RTK's geometry has a parallel beam and others have not")
    depth = rtk.SourceToIsocenterDistance - rtk.SourceToDetectorDistance
    depth = np.where(parallel, -rtk.SourceToIsocenterDistance, depth)

    def at(x: Numbers, y: Numbers, z: Numbers) -> VectorPerView:
        return x[:, None] * across + y[:, None] * up + z[:, None] * normal

    center = at(rtk.ProjectionOffsetX, rtk.ProjectionOffsetY, depth)
    steps = center, panel.column_pitch * across, -panel.row_pitch * up
    size, angles = (panel.rows, panel.columns), np.deg2rad(rtk.GantryAngle)
    if parallel.all():
        return geometry_of(*steps, size, ray_direction=-normal, angles=angles)
    source = at(rtk.SourceOffsetX, rtk.SourceOffsetY, rtk.SourceToIsocenterDistance)
    radius = rtk.RadiusCylindricalDetector
    if not radius:
        return geometry_of(*steps, size, source=source, angles=angles)
    along = rtk.ProjectionOffsetX / radius
    cosine, sine = np.cos(along), np.sin(along)
    center = at(radius * sine, rtk.ProjectionOffsetY, depth + radius * (1 - cosine))
    column = panel.column_pitch * (cosine[:, None] * across + sine[:, None] * normal)
    flat = geometry_of(center, column, steps[2], size, source=source, angles=angles)
    curvature = panel.curvature or Curvature(radius, panel.columns)
    curved = replace(flat, panel=replace(panel, curvature=curvature))
    flat_modules(curved)  # refuses a panel that is wrapped past the source
    return curved


def rtk_matrices(rtk: RtkGeometry) -> Float[np.ndarray, "view 3 4"]:
    """Compute the projection matrices that RTK's files repeat: from RTK's axes to mm on the panel.

    Parameters
    ----------
    rtk : the numbers

    Returns
    -------
    one matrix per view
    """
    turn = _rotations(rtk.GantryAngle, rtk.OutOfPlaneAngle, rtk.InPlaneAngle)
    matrix = np.zeros((len(rtk), 3, 4))
    source = np.stack([rtk.SourceOffsetX, rtk.SourceOffsetY, rtk.SourceToIsocenterDistance], axis=1)
    shift = source[:, :2] - np.stack([rtk.ProjectionOffsetX, rtk.ProjectionOffsetY], axis=1)
    for view, (sdd, rotation) in enumerate(zip(rtk.SourceToDetectorDistance, turn, strict=True)):
        rigid = np.hstack([rotation, -source[view, :, None]])
        # points of the panel are relative to its centre, as the shift says
        magnified = np.array([[-sdd, 0, shift[view, 0]], [0, -sdd, shift[view, 1]], [0, 0, 1]])
        if sdd == 0:
            rigid[2], magnified[0, 0], magnified[1, 1] = [0, 0, 0, 1], 1, 1
        matrix[view] = magnified @ rigid
    return matrix


def to_rtk_object(geometry: Geometry) -> Any:
    """Convert poses to RTK's own object.

    Parameters
    ----------
    geometry : poses

    Returns
    -------
    ``itk.RTK.ThreeDCircularProjectionGeometry``

    Raises
    ------
    NotInstalledError
        When itk-rtk is not there.
    GeometryError
        As `to_rtk`, or where RTK refuses a view.
    """
    try:
        itk = import_module("itk")
        poses = itk.RTK.ThreeDCircularProjectionGeometry.New()
    except (ImportError, AttributeError):
        raise NotInstalledError("RTK's geometry as an object needs itk-rtk: pip install itk-rtk") from None
    if geometry.is_parallel:
        lengths = [values for values in vars(to_rtk(geometry)).values() if isinstance(values, np.ndarray)]
        for numbers in zip(*lengths, strict=True):
            poses.AddProjection(*map(float, numbers))
        return poses
    for view, vectors in enumerate(zip(*_in_rtk_axes(geometry), strict=True)):
        source, center, across, up = (vector.tolist() for vector in vectors)
        point, vector = itk.Point[itk.D, 3], itk.Vector[itk.D, 3]
        if not poses.AddProjection(point(source), point(center), vector(across), vector(up)):
            raise GeometryError(f"RTK refuses the pose of view {view}")
    if geometry.panel.curvature is not None:
        poses.SetRadiusCylindricalDetector(geometry.panel.curvature.radius)
    return poses


def from_rtk_object(poses: Any, panel: Panel) -> Geometry:
    """Convert RTK's own object to poses.

    Parameters
    ----------
    poses : ``itk.RTK.ThreeDCircularProjectionGeometry``
    panel : the pixel grid

    Returns
    -------
    the poses
    """
    angles = (
        np.rad2deg(getattr(poses, f"Get{name}s")()) for name in ("GantryAngle", "OutOfPlaneAngle", "InPlaneAngle")
    )
    gantry, outer, inner = angles
    lengths = {
        name: np.array(getattr(poses, f"Get{plural}")(), dtype=np.float64)
        for name, plural in (
            ("SourceToIsocenterDistance", "SourceToIsocenterDistances"),
            ("SourceToDetectorDistance", "SourceToDetectorDistances"),
            ("ProjectionOffsetX", "ProjectionOffsetsX"),
            ("ProjectionOffsetY", "ProjectionOffsetsY"),
            ("SourceOffsetX", "SourceOffsetsX"),
            ("SourceOffsetY", "SourceOffsetsY"),
        )
    }
    turned = {"GantryAngle": gantry, "OutOfPlaneAngle": outer, "InPlaneAngle": inner}
    radius = float(poses.GetRadiusCylindricalDetector())
    return from_rtk(RtkGeometry(**turned, **lengths, RadiusCylindricalDetector=radius), panel)


def _in_rtk_axes(geometry: Geometry) -> tuple[VectorPerView, VectorPerView, VectorPerView, VectorPerView]:
    """Source, centre of the panel, and its axes along columns and upwards, in RTK's axes; a curved panel unrolled."""
    column, row = right_angled_steps(geometry, "RTK", curved=True)
    away = np.cross(column, row)
    if geometry.ray_direction is not None:
        slant = np.linalg.norm(geometry.ray_direction - away, axis=1)
        if slant.max(initial=0) > _PERPENDICULAR:
            raise GeometryError(f"RTK's parallel beam meets the panel at right angles: view {slant.argmax()} does not")
    mirrored = np.einsum("vi,vi->v", away, geometry.panel_center - geometry.source) < 0
    if mirrored.any():
        raise GeometryError(
            f"RTK needs columns that count to the right where rows count down, seen from the source: those of view "
            f"{mirrored.argmax()} are mirrored"
        )
    vectors = geometry.source, geometry.panel_center, column, -row
    source, center, across, up = (vector[:, _TO_RTK] for vector in vectors)
    if geometry.panel.curvature is not None:
        center, across = _unrolled(center, across, up, geometry.panel.curvature.radius)
    return source, center, across, up


def _unrolled(
    center: VectorPerView, across: VectorPerView, up: VectorPerView, radius: float
) -> tuple[VectorPerView, VectorPerView]:
    """Centre and axis along columns of the flat panel that touches a cylinder where the isocentre's normal meets it."""
    normal = np.cross(across, up)
    axis = center + radius * normal
    height = np.einsum("vi,vi->v", axis, up)[:, None]
    toward = axis - height * up
    distance = np.linalg.norm(toward, axis=1, keepdims=True)
    central = distance < _CENTRAL * radius  # where the axis passes the isocentre, any normal does
    toward = np.where(central, normal, toward / np.where(central, 1.0, distance))
    toward *= np.where(np.einsum("vi,vi->v", toward, normal) < 0, -1.0, 1.0)[:, None]
    beside = np.cross(up, toward)
    sine, cosine = -np.einsum("vi,vi->v", normal, beside), np.einsum("vi,vi->v", normal, toward)
    depth = np.einsum("vi,vi->v", axis, toward) - radius
    arc = radius * np.arctan2(sine, cosine)
    return depth[:, None] * toward + arc[:, None] * beside + height * up, beside


def _angles(turn: Float[np.ndarray, "view 3 3"]) -> tuple[Numbers, Numbers, Numbers]:
    """Gantry, out-of-plane and in-plane angle [degree] with Rz(-in) Rx(-out) Ry(-gantry) = turn."""
    gantry = np.arctan2(turn[:, 2, 0], turn[:, 2, 2])
    about_y = _rotations(np.rad2deg(gantry), np.zeros_like(gantry), np.zeros_like(gantry))
    rest = turn @ np.swapaxes(about_y, 1, 2)
    outer, inner = np.arctan2(-rest[:, 2, 1], rest[:, 2, 2]), np.arctan2(-rest[:, 1, 0], rest[:, 0, 0])
    found = (np.rad2deg(angle) % 360.0 for angle in (gantry, outer, inner))
    gantry, outer, inner = (np.where(angle == 360.0, 0.0, angle) for angle in found)
    return gantry, outer, inner


def _rotations(gantry: Numbers, outer: Numbers, inner: Numbers) -> Float[np.ndarray, "view 3 3"]:
    """Rz(-in) Rx(-out) Ry(-gantry): rows are the panel's axes and its normal in RTK's axes."""
    (cg, sg), (co, so), (ci, si) = ((np.cos(a), np.sin(a)) for a in map(np.deg2rad, (gantry, outer, inner)))
    zero, one = np.zeros_like(cg), np.ones_like(cg)

    def matrices(*rows: list[Numbers]) -> Float[np.ndarray, "view 3 3"]:
        return np.moveaxis(np.array(rows), 2, 0)

    about_y = matrices([cg, zero, -sg], [zero, one, zero], [sg, zero, cg])
    about_x = matrices([one, zero, zero], [zero, co, so], [zero, -so, co])
    about_z = matrices([ci, si, zero], [-si, ci, zero], [zero, zero, one])
    return about_z @ about_x @ about_y
