"""Mount of a panel: shifts in its plane, tilts, and rotation in its plane."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.curved_panel import shifted_along
from phantomgen.geometry.poses import FAR, Geometry
from phantomgen.geometry.rotation import rotation_matrix

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Mount:
    """Shift and tilt of a panel from the nominal one, whose centre the central ray meets at right angles.

    The panel's axes are u, along which columns count, v, along which rows count, and w = u x v, away from the source.

    Parameters
    ----------
    offset : shift of the panel's centre along u, of a curved one along its cylinder, and along v [mm]
    tilt : turns about the fixed axes u, then v, then w, through the panel's centre, right-handed [rad]
    """

    offset: tuple[float, float] = (0.0, 0.0)
    tilt: Triple = (0.0, 0.0, 0.0)

    @property
    def turn(self) -> Float[np.ndarray, "3 3"]:
        """Rotation of the panel, in coordinates along (u, v, w)."""
        return rotation_matrix(self.tilt)


def mounted(geometry: Geometry, mount: Mount) -> Geometry:
    """Shift, tilt and turn the panel of a scan.

    Parameters
    ----------
    geometry : poses with the nominal panel
    mount : shift and tilt

    Returns
    -------
    poses with the mounted panel
    """
    if mount == Mount():
        return geometry
    across, down = mount.offset
    geometry = shifted_along(geometry, across)
    steps = np.stack([geometry.column_step, geometry.row_step], axis=1)
    unit = steps / np.linalg.norm(steps, axis=2, keepdims=True)
    frames = np.concatenate([unit, np.cross(unit[:, 0], unit[:, 1])[:, None]], axis=1)
    pitches = np.array([geometry.panel.column_pitch, geometry.panel.row_pitch])
    turned = np.einsum("p,kp,vki->vpi", pitches, mount.turn[:, :2], frames)
    center = geometry.panel_center + down * unit[:, 1]
    moved = replace(geometry, panel_center=center, column_step=turned[:, 0], row_step=turned[:, 1])
    return with_parallel_source(moved)


def with_parallel_source(geometry: Geometry) -> Geometry:
    """Put the far source of a parallel beam behind the panel's centre in each view.

    Parameters
    ----------
    geometry : poses

    Returns
    -------
    poses; unchanged where the beam is not parallel
    """
    if geometry.ray_direction is None:
        return geometry
    return replace(geometry, source=geometry.panel_center - FAR * geometry.ray_direction)
