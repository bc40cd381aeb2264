"""Orbits: paths of the source around the object, as functions that return a `Geometry`.

All turn about the z axis and begin, at angle 0, on the side of +x; columns count the way the source moves, and rows
from +z downwards. The circular orbit itself is `Geometry.circular`.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry, VectorPerView
from spectra.errors import GeometryError

Angles = Float[np.ndarray, " view"]


def spread_angles(views: int, test_views: int, arc: float = 360.0, start: float = 0.0) -> Angles:
    """Compute angles of the source: training views, then test views.

    Training views stand at start + i arc / views degrees, so that the end of the arc belongs to it no more than 360
    degrees do to a circle; test views at start + (j + 1/2) arc / test_views.

    Parameters
    ----------
    views : number of training views
    test_views : number of test views
    arc : angle of the arc [degree]
    start : first angle [degree]

    Returns
    -------
    angles [rad]
    """
    train = np.arange(views) * (arc / views)
    test = (np.arange(test_views) + 0.5) * (arc / max(test_views, 1))
    return np.deg2rad(np.concatenate([train, test]) + start)


def between(positions: Float[np.ndarray, " view"], count: int) -> Float[np.ndarray, " between"]:
    """Compute the middles of `count` of the gaps between neighbours, evenly selected.

    Parameters
    ----------
    positions : of the training views, ascending
    count : number of gaps

    Returns
    -------
    middles

    Raises
    ------
    GeometryError
        When there are fewer gaps.
    """
    gaps = len(positions) - 1
    if count > gaps:
        raise GeometryError(f"{count} test views do not fit between {len(positions)} angles: at most {max(gaps, 0)} do")
    picked = ((np.arange(count) + 0.5) * gaps / max(count, 1)).astype(int)
    return (positions[picked] + positions[picked + 1]) / 2


def short_arc(half_fan: float) -> float:
    """Compute the arc on which every ray through the object is measured at least once: half a turn and the fan.

    Parameters
    ----------
    half_fan : largest fan angle of a ray to the panel [rad]

    Returns
    -------
    arc [degree]

    References
    ----------
    Parker 1982, doi:10.1118/1.595078.
    """
    return min(180.0 + 2.0 * float(np.rad2deg(half_fan)), 360.0)


def helical(sod: float, sdd: float, angles: Angles, pitch: float, panel: Panel, z: float = 0.0) -> Geometry:
    """Create a helical orbit: a circle whose source and panel rise together.

    Parameters
    ----------
    sod, sdd : distance from the source to the axis and to the panel [mm]
    angles : of the source, counter-clockwise from +x, of several turns where there are [rad]
    pitch : rise per turn [mm]; negative for a helix that falls
    panel : the pixel grid
    z : height of the source at angle 0 [mm]

    Returns
    -------
    poses of all views
    """
    circle = Geometry.circular(sod, sdd, angles, panel)
    rise = np.zeros_like(circle.source)
    rise[:, 2] = z + pitch * np.asarray(angles) / (2 * np.pi)
    source, center = circle.source + rise, circle.panel_center + rise
    return replace(circle, source=source, panel_center=center, kind="helical")


def deflected(geometry: Geometry, deflections: VectorPerView) -> Geometry:
    """Move the focal spot from its nominal position, as a flying focal spot does; the panel stays.

    Parameters
    ----------
    geometry : circular or helical orbit
    deflections : along the way columns count, along z, and away from the rotation axis, (view, 3) [mm]

    Returns
    -------
    poses with the moved sources; `angles` stay those of the gantry

    Raises
    ------
    GeometryError
        When a deflection reaches the axis.

    References
    ----------
    Kachelriess, Knaup, Penssel, Kalender 2006, doi:10.1109/TNS.2006.874076.
    """
    sod = np.linalg.norm(geometry.source[:, :2], axis=1)
    if len(sod) and (longest := float(np.linalg.norm(deflections, axis=1).max())) >= sod.min():
        raise GeometryError(
            f"a focal spot is {longest:g} mm from its nominal position: it must be less than {sod.min():g} mm"
        )
    along = geometry.column_step / geometry.panel.column_pitch
    outward = geometry.source * (1.0, 1.0, 0.0) / sod[:, None]
    moved = deflections[:, :1] * along + deflections[:, 2:] * outward
    moved[:, 2] += deflections[:, 1]
    return replace(geometry, source=geometry.source + moved)


def laminography(sod: float, sdd: float, angles: Angles, tilt: float, panel: Panel) -> Geometry:
    """Create a circular orbit of a source above a flat object, with the beam tilted against the plane of the orbit.

    Parameters
    ----------
    sod, sdd : distance from the source to the isocentre and to the panel [mm]
    angles : of the source, counter-clockwise from +x [rad]
    tilt : how far the rotation axis leans out of the plane across the beam; 0 is a circular orbit [rad]
    panel : the pixel grid, across the central ray

    Returns
    -------
    poses of all views
    """
    _check_distances("laminography", sod, sdd)
    beam, tangent, down = _tilted_frames(angles, tilt)
    return Geometry(
        source=-sod * beam,
        panel_center=(sdd - sod) * beam,
        column_step=panel.column_pitch * tangent,
        row_step=panel.row_pitch * down,
        panel=panel,
        angles=np.asarray(angles, dtype=np.float64),
        kind="laminography",
    )


def parallel(distance: float, angles: Angles, panel: Panel, tilt: float = 0.0) -> Geometry:
    """Create views in a parallel beam across the axis, or tilted against that.

    Parameters
    ----------
    distance : from the axis to the panel [mm]
    angles : where the beam comes from, counter-clockwise from +x [rad]
    panel : the pixel grid, across the beam
    tilt : of the rotation axis, as in `laminography` [rad]

    Returns
    -------
    poses of all views

    Raises
    ------
    GeometryError
        When the geometry is impossible.
    """
    if not distance > 0:
        raise GeometryError(f"a parallel beam needs a panel behind the axis, distance > 0, got {distance:g} mm")
    beam, tangent, down = _tilted_frames(angles, tilt)
    return Geometry.parallel(
        beam, distance * beam, panel.column_pitch * tangent, panel.row_pitch * down, panel, np.asarray(angles)
    )


def _check_distances(what: str, sod: float, sdd: float) -> None:
    """Refuse an axis that does not lie between source and panel."""
    if not 0 < sod < sdd:
        raise GeometryError(f"{what} needs 0 < sod < sdd, got sod {sod:g} mm and sdd {sdd:g} mm")


def _tilted_frames(angles: Angles, tilt: float) -> tuple[VectorPerView, VectorPerView, VectorPerView]:
    """Unit vectors per view: along the central ray, along columns, along rows."""
    if not abs(tilt) < np.pi / 2:
        raise GeometryError(
            f"the tilt of the rotation axis must lie within -90 .. 90 degrees, got {np.rad2deg(tilt):g}"
        )
    angles = np.asarray(angles, dtype=np.float64)
    c, s, zero = np.cos(angles), np.sin(angles), np.zeros_like(angles)
    across, up = np.cos(tilt), np.sin(tilt)
    beam = -np.stack([across * c, across * s, up + zero], axis=1)
    down = np.stack([up * c, up * s, zero - across], axis=1)
    return beam, np.stack([-s, c, zero], axis=1), down
