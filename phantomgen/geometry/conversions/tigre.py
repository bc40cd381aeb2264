"""TIGRE's geometry: distances, three Euler angles per view, offsets and rotations of the panel.

Names are those of ``tigre.geometry``; triples of volumes are (z, y, x), pairs of the panel (v, u). TIGRE's rows go up:
``projections[:, ::-1]`` of ours, (view, row, column), are what it takes. Volumes are (z, y, x).

References
----------
.. [1] https://github.com/CERN/TIGRE, Common/CUDA/Siddon_projection.cu (computeDeltas_Siddon) and
       Python/tigre/utilities/geometry.py.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.conversions.panel_axes import geometry_of, right_angled_steps
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from spectra.errors import GeometryError

Turns = Float[np.ndarray, "view 3 3"]
_PERPENDICULAR = 1e-6  # cosine of the angle between a parallel beam and its panel that counts as a right angle


@dataclass(frozen=True, eq=False)
class TigreGeometry:
    """Fields of ``tigre.geometry`` that say where source and panel are.

    Parameters
    ----------
    mode : ``cone`` or ``parallel``
    nDetector : number of rows and columns
    dDetector : pitch of rows and columns [mm]
    angles : about z, y, z of the turned frame (alpha, theta, psi) [rad]
    DSO, DSD : distance from the source to the isocentre, and to the panel before its rotation [mm]
    offDetector : shift of the panel upwards and along columns (v, u) [mm]
    rotDetector : turns of the panel about its centre, about fixed x, then y, then z [rad]
    """

    mode: Literal["cone", "parallel"]
    nDetector: tuple[int, int]
    dDetector: tuple[float, float]
    angles: Float[np.ndarray, "view 3"]
    DSO: Float[np.ndarray, " view"]
    DSD: Float[np.ndarray, " view"]
    offDetector: Float[np.ndarray, "view 2"]
    rotDetector: Float[np.ndarray, "view 3"]


def to_tigre(geometry: Geometry) -> TigreGeometry:
    """Convert poses to TIGRE's parameters.

    Parameters
    ----------
    geometry : poses

    Returns
    -------
    the parameters

    Raises
    ------
    GeometryError
        When pixels are no rectangles of one size, a source lies in the isocentre, or a parallel beam does not meet the
        panel at right angles.
    """
    column, row = right_angled_steps(geometry, "TIGRE")
    panel, outward = geometry.panel, -np.cross(column, row)  # towards the source, as x of TIGRE's frame
    frame = np.stack([outward, column, -row], axis=2)
    if geometry.ray_direction is None:
        dso = np.linalg.norm(geometry.source, axis=1)
        if dso.min(initial=np.inf) < 1e-9:
            raise GeometryError(f"TIGRE cannot have the source of view {dso.argmin()} in the isocentre")
        angles = np.zeros((len(geometry), 3))
        angles[:, 0] = np.arctan2(geometry.source[:, 1], geometry.source[:, 0])
        angles[:, 1] = -np.arctan2(geometry.source[:, 2], np.hypot(geometry.source[:, 0], geometry.source[:, 1]))
        turn = _euler(angles)
    else:
        _check_perpendicular(geometry, outward)
        angles, turn = _euler_angles(frame), frame
        dso = np.abs(np.einsum("vi,vi->v", geometry.panel_center, outward))
    center = np.einsum("vji,vj->vi", turn, geometry.panel_center)
    turned = np.einsum("vji,vjk->vik", turn, frame)
    return TigreGeometry(
        mode="parallel" if geometry.is_parallel else "cone",
        nDetector=(panel.rows, panel.columns),
        dDetector=(panel.row_pitch, panel.column_pitch),
        angles=angles,
        DSO=dso,
        DSD=dso - center[:, 0],
        offDetector=center[:, [2, 1]],
        rotDetector=_fixed_axis_angles(turned) if geometry.ray_direction is None else np.zeros((len(geometry), 3)),
    )


def from_tigre(tigre: TigreGeometry) -> Geometry:
    """Convert TIGRE's parameters to poses.

    Parameters
    ----------
    tigre : the parameters; volumes of TIGRE with an ``offOrigin`` have it in their grid

    Returns
    -------
    the poses, with alpha as angles

    Raises
    ------
    GeometryError
        When the poses are impossible.
    """
    turn, (pitch_v, pitch_u) = _euler(tigre.angles), tigre.dDetector
    local = np.stack([tigre.DSO - tigre.DSD, tigre.offDetector[:, 1], tigre.offDetector[:, 0]], axis=1)
    center = np.einsum("vij,vj->vi", turn, local)
    panel = turn @ _about(tigre.rotDetector[:, 2], 2) @ _about(tigre.rotDetector[:, 1], 1)
    panel = panel @ _about(tigre.rotDetector[:, 0], 0) if tigre.mode == "cone" else turn
    steps = center, pitch_u * panel[:, :, 1], -pitch_v * panel[:, :, 2]
    angles = np.ascontiguousarray(tigre.angles[:, 0])
    if tigre.mode == "cone":
        return geometry_of(*steps, tigre.nDetector, source=tigre.DSO[:, None] * turn[:, :, 0], angles=angles)
    return geometry_of(*steps, tigre.nDetector, ray_direction=-turn[:, :, 0], angles=angles)


def to_tigre_volume(grid: Grid) -> dict[str, tuple]:
    """Convert a grid to fields of ``tigre.geometry``.

    Parameters
    ----------
    grid : voxels

    Returns
    -------
    ``nVoxel``, ``dVoxel`` [mm], ``sVoxel`` [mm] and ``offOrigin`` [mm], each (z, y, x)
    """
    size = tuple(n * s for n, s in zip(grid.shape, grid.spacing, strict=True))
    center = tuple(o + (n - 1) / 2 * s for n, s, o in zip(grid.shape, grid.spacing, grid.origin, strict=True))
    return {"nVoxel": grid.shape, "dVoxel": grid.spacing, "sVoxel": size, "offOrigin": center}


def _check_perpendicular(geometry: Geometry, outward: Float[np.ndarray, "view 3"]) -> None:
    """Refuse parallel beams that meet the panel at a slant: TIGRE's run along the panel's normal."""
    slant = np.linalg.norm(geometry.ray_direction + outward, axis=1)
    if slant.max(initial=0) > _PERPENDICULAR:
        raise GeometryError(
            "TIGRE's parallel beam meets the panel at right angles, with columns and rows as ours: view "
            f"{slant.argmax()} is {np.rad2deg(2 * np.arcsin(min(slant.max() / 2, 1))):.6g} degrees off"
        )


def _about(angle: Float[np.ndarray, " view"], axis: int) -> Turns:
    """Right-handed rotations about a coordinate axis."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turn = np.zeros((len(angle), 3, 3))
    turn[:, axis, axis] = 1
    turn[:, i, i] = turn[:, j, j] = np.cos(angle)
    turn[:, j, i], turn[:, i, j] = np.sin(angle), -np.sin(angle)
    return turn


def _euler(angles: Float[np.ndarray, "view 3"]) -> Turns:
    """Rz(alpha) Ry(theta) Rz(psi)."""
    return _about(angles[:, 0], 2) @ _about(angles[:, 1], 1) @ _about(angles[:, 2], 2)


def _euler_angles(turn: Turns) -> Float[np.ndarray, "view 3"]:
    """(alpha, theta, psi) of rotations, with psi = 0 where theta is 0."""
    up, outward = turn[:, :, 2], turn[:, :, 0]
    sign = np.where(up[:, 0] * outward[:, 0] + up[:, 1] * outward[:, 1] < 0, -1.0, 1.0)
    flat = np.hypot(up[:, 0], up[:, 1]) < 1e-12
    x, y = (np.where(flat, outward[:, i], sign * up[:, i]) for i in (0, 1))
    alpha = np.arctan2(y, x)
    rest = _about(-alpha, 2) @ turn
    return np.stack([alpha, np.arctan2(rest[:, 0, 2], rest[:, 2, 2]), np.arctan2(rest[:, 1, 0], rest[:, 1, 1])], axis=1)


def _fixed_axis_angles(turn: Turns) -> Float[np.ndarray, "view 3"]:
    """Angles (a, b, c) with Rz(c) Ry(b) Rx(a) = turn."""
    about_z = np.arctan2(turn[:, 1, 0], turn[:, 0, 0])
    rest = _about(-about_z, 2) @ turn
    about_x, about_y = np.arctan2(-rest[:, 1, 2], rest[:, 1, 1]), np.arctan2(-rest[:, 2, 0], rest[:, 0, 0])
    return np.stack([about_x, about_y, about_z], axis=1)
