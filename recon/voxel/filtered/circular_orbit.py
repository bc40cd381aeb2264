"""Circular orbits about the z axis, and what filtered back-projection needs to know of them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.flat_panel import flat_equivalent
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from spectra.errors import GeometryError

# Tolerances of an orbit; all chosen by hand, not measured.
_EVEN = 1.5  # no unit; widest gap between neighbouring views over the mean gap
_SAME = 0.01  # no unit; largest relative difference of distances between views
_FLAT = 0.02  # rad; largest slope of the central ray, and largest tilt of a panel that counts as upright
_STEEP = 0.8  # rad; largest angle between a panel and an upright one; the rotation in its plane is not limited
_CENTRED = 0.05  # of the columns; largest distance of the central ray from the middle of a centred panel
_OVERLAP = 0.02  # of the columns; least part of a panel that lies beyond the axis


@dataclass(frozen=True, eq=False)
class CircularOrbit:
    """A full circle, or an arc on which every ray is measured at least once.

    Parameters
    ----------
    angles : angle of the source from the beginning of the arc, counter-clockwise; each view stands for a piece of the
        arc with its angle in the middle [rad]
    arc : length of the arc [rad]; 2 pi for a full circle
    sod, sdd : distance from the source to the axis, and to the panel; along the central ray if the panel is tilted [mm]
    outward : unit vectors from the axis to the source
    middle : column that the central ray meets [pixel]
    tilt : the larger of two angles: panel to an upright panel, and panel rows to the plane of the circle [rad]
    is_centred : whether the panel covers both sides of the axis equally
    """

    angles: Float[np.ndarray, " view"]
    arc: float
    sod: Float[np.ndarray, " view"]
    sdd: Float[np.ndarray, " view"]
    outward: Float[np.ndarray, "view 3"]
    middle: Float[np.ndarray, " view"]
    tilt: float
    is_centred: bool

    @property
    def is_full(self) -> bool:
        """Whether the orbit is a full circle."""
        return bool(self.arc >= 2 * np.pi)

    @property
    def is_z_aligned(self) -> bool:
        """Whether the rows of the panel are parallel to the plane of the circle."""
        return bool(self.tilt <= _FLAT)

    @property
    def spare(self) -> float:
        """Half of the arc beyond half a turn [rad]."""
        return max((self.arc - np.pi) / 2, 0.0)


def circular_orbit_of(geometry: Geometry, grid: Grid | None = None) -> CircularOrbit:
    """Describe an orbit for filtered back-projection.

    Parameters
    ----------
    geometry : poses of the views
    grid : the volume; a short scan must measure every ray through it, not every ray of the panel

    Returns
    -------
    the circular orbit

    Raises
    ------
    GeometryError
        Unless views stand evenly on a full circle about the z axis or on an arc of at least half a turn and the fan,
        and the panel covers the axis; the sentence names the reason.
    """
    geometry = flat_equivalent(geometry)
    if len(geometry) < 2:
        raise _refusal(geometry, "it has fewer than two views")
    sod = np.linalg.norm(geometry.source[:, :2], axis=1)
    if sod.min() <= 0 or np.ptp(sod) > _SAME * sod.min() or np.abs(geometry.source[:, 2]).max() > _FLAT * sod.min():
        raise _refusal(geometry, "its source does not keep its distance from the axis and its height")
    angles, arc = _arc(geometry)
    outward = geometry.source / sod[:, None]
    lean = np.arccos(np.clip(np.abs(np.einsum("vi,vi->v", geometry.normals(), outward)), 0, 1)).max()
    turn = np.arcsin(np.clip(np.abs(geometry.column_step[:, 2]) / geometry.panel.column_pitch, 0, 1)).max()
    if lean > _STEEP:
        raise _refusal(geometry, f"its panel is tilted by {np.rad2deg(lean):.3g} degrees")
    tilt = float(max(lean, turn))
    frames = geometry.ray_frames()
    axes = np.stack([frames[:, 2], frames[:, 3], frames[:, 1]], axis=-1)
    column, _, depth = np.linalg.solve(axes, -outward[..., None])[..., 0].T
    if depth.min() <= 0 or np.ptp(1 / depth) > _SAME / depth.max():
        raise _refusal(geometry, "its panel does not keep its distance from the source")
    middle, columns = column / depth, geometry.panel.columns
    height = np.abs(np.einsum("vi,vi->v", geometry.panel_center - geometry.source, geometry.normals()))
    circle = CircularOrbit(
        angles, arc, sod, height if tilt <= _FLAT else 1 / depth, outward, middle, tilt,
        bool(np.abs(middle - (columns - 1) / 2).max() <= _CENTRED * columns),
    )  # fmt: skip
    _check_rays(geometry, grid, circle)
    return circle


def _refusal(geometry: Geometry, reason: str) -> GeometryError:
    return GeometryError(
        "filtered back-projection needs at least two evenly spaced views on a full circle about the z axis, or on half "
        f"a turn and the fan, and a panel that sees the axis; {reason} ({geometry.kind} geometry)"
    )


def _arc(geometry: Geometry) -> tuple[Float[np.ndarray, " view"], float]:
    """Angles of the source from the beginning of the arc, and its length [rad]."""
    views = len(geometry)
    angles = np.arctan2(geometry.source[:, 1], geometry.source[:, 0])
    order = np.argsort(angles)
    gaps = np.diff(angles[order], append=angles[order[0]] + 2 * np.pi)
    if gaps.max() <= _EVEN * 2 * np.pi / views:
        return np.mod(angles - angles[order[0]], 2 * np.pi), 2 * np.pi
    widest = int(gaps.argmax())
    others = np.delete(gaps, widest)
    step = (2 * np.pi - gaps[widest]) / (views - 1)
    if others.max() > _EVEN * step:
        raise _refusal(geometry, f"its views leave gaps of {', '.join(_degrees(np.sort(gaps)[::-1][:2]))} degrees")
    first = angles[order[(widest + 1) % views]]
    return np.mod(angles - first + 1e-9, 2 * np.pi) + step / 2 - 1e-9, views * step


def _degrees(angles: Float[np.ndarray, " angle"]) -> list[str]:
    return [f"{angle:.3g}" for angle in np.rad2deg(angles)]


def _check_rays(geometry: Geometry, grid: Grid | None, circle: CircularOrbit) -> None:
    """Refuse arcs that miss rays, and panels that do not cover the axis."""
    columns = geometry.panel.columns
    sides = np.array([circle.middle.min() + 0.5, columns - 0.5 - circle.middle.max()])
    if sides.min() < _OVERLAP * columns:
        raise _refusal(geometry, "its panel lies on one side of the axis")
    if circle.is_full:
        return
    if not circle.is_centred:
        shift = float(np.abs(circle.middle - (columns - 1) / 2).max()) * geometry.panel.column_pitch
        raise _refusal(geometry, f"its panel is {shift:.4g} mm off the centre and its arc is not a full circle")
    fan = np.arctan(sides.max() * geometry.panel.column_pitch / circle.sdd.min())
    if grid is not None:
        fan = min(fan, _half_fan(grid, float(circle.sod.min())))
    if circle.arc * (1 + 0.5 / len(geometry)) < np.pi + 2 * fan:  # half a step is not worth a refusal
        raise _refusal(geometry, f"its arc of {_degrees(np.array([circle.arc]))[0]} degrees is too short")


def _half_fan(grid: Grid, sod: float) -> float:
    """Largest angle at the source between the axis and a voxel [rad]."""
    corners = [np.abs(grid.axis(name)).max() + grid.spacing["zyx".index(name)] / 2 for name in "xy"]
    return float(np.arcsin(min(np.hypot(*corners) / sod, 1.0)))
