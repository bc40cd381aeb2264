"""Whether a fit can start from an orbit: filtered back-projection needs a full circle about the z axis."""

import numpy as np

from phantomgen.geometry import Geometry
from spectra.errors import GeometryError

_EVEN = 1.5  # widest gap between neighbouring views over the mean one
_SAME = 0.01  # by what part distances may differ between views
_FLAT = 0.02  # largest slope of the central ray, and largest tilt of the panel [rad]
_CENTRED = 0.05  # largest distance of the central ray from the middle of the panel, as a part of its columns


def check_full_circle(geometry: Geometry) -> None:
    """Refuse geometries that filtered back-projection gives wrong volumes for.

    Raises
    ------
    GeometryError
        With what is in the way, unless views stand evenly on a full circle about the z axis, face a panel whose rows
        run along the circle, and see both sides of the axis.
    """
    reason = "it has fewer than two views" if len(geometry) < 2 else _obstacle(geometry)
    if reason is not None:
        raise GeometryError(
            "the start of a fit, FDK, needs a full circular orbit of at least two evenly spaced views about the z axis "
            f"and an upright, centred panel; {reason} ({geometry.kind} geometry)"
        )


def _obstacle(geometry: Geometry) -> str | None:
    """What keeps a geometry from being a full circle, None where nothing does."""
    source = geometry.source
    sod = np.linalg.norm(source[:, :2], axis=1)
    if sod.min() <= 0 or np.ptp(sod) > _SAME * sod.min() or np.abs(source[:, 2]).max() > _FLAT * sod.min():
        return "its source does not keep its distance from the axis and its height"
    angles = np.sort(np.arctan2(source[:, 1], source[:, 0]))
    widest = float(np.diff(angles, append=angles[0] + 2 * np.pi).max())
    if widest > _EVEN * 2 * np.pi / len(geometry):
        return f"its views leave a gap of {np.rad2deg(widest):.3g} degrees"
    return _panel_obstacle(geometry, source / sod[:, None])


def _panel_obstacle(geometry: Geometry, outward: np.ndarray) -> str | None:
    """The same for the panel; `outward` are unit vectors from the axis to the source."""
    tilt = np.arccos(np.clip(np.abs(np.einsum("vi,vi->v", geometry.normals(), outward)), 0, 1)).max()
    column = geometry.column_step / geometry.panel.column_pitch
    turn = np.arcsin(np.clip(np.abs(column[:, 2]), 0, 1)).max()
    if max(tilt, turn) > _FLAT:
        return f"its panel is tilted by {np.rad2deg(max(tilt, turn)):.3g} degrees"
    distance = np.abs(np.einsum("vi,vi->v", geometry.panel_center - geometry.source, geometry.normals()))
    if np.ptp(distance) > _SAME * distance.min():
        return "its panel does not keep its distance from the source"
    foot = geometry.source - distance[:, None] * outward - geometry.panel_center
    shift = np.abs(np.einsum("vi,vi->v", foot, column)).max()
    if shift > _CENTRED * geometry.panel.columns * geometry.panel.column_pitch:
        return f"its panel is {shift:.4g} mm off the centre along its rows"
    return None
