"""TIGRE's geometry: distances, three Euler angles per view, offsets and rotations of the panel.

Names are those of ``tigre.geometry``; triples of volumes are (z, y, x), pairs of the panel (v, u). TIGRE's rows go up:
``projections[:, ::-1]`` of ours, (view, row, column), are what it takes. Volumes are (z, y, x).

References
----------
.. [1] https://github.com/CERN/TIGRE, Common/CUDA/Siddon_projection.cu (computeDeltas_Siddon),
       Siddon_projection_parallel.cu and Python/tigre/utilities/geometry.py.
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
_LEVEL = 1e-6  # of a pixel; a parallel panel may be shifted along z by so much


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
    COR : shift of source and panel along columns at alpha [mm]; how a parallel beam says an offset of its panel, whose
        rays `offDetector` would slant
    """

    mode: Literal["cone", "parallel"]
    nDetector: tuple[int, int]
    dDetector: tuple[float, float]
    angles: Float[np.ndarray, "view 3"]
    DSO: Float[np.ndarray, " view"]
    DSD: Float[np.ndarray, " view"]
    offDetector: Float[np.ndarray, "view 2"]
    rotDetector: Float[np.ndarray, "view 3"]
    COR: Float[np.ndarray, " view"]


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
    angles, zero = np.zeros((len(geometry), 3)), np.zeros(len(geometry))
    if geometry.ray_direction is None:
        dso = np.linalg.norm(geometry.source, axis=1)
        if dso.min(initial=np.inf) < 1e-9:
            raise GeometryError(f"TIGRE cannot have the source of view {dso.argmin()} in the isocentre")
        angles[:, 0] = np.arctan2(geometry.source[:, 1], geometry.source[:, 0])
        angles[:, 1] = -np.arctan2(geometry.source[:, 2], np.hypot(geometry.source[:, 0], geometry.source[:, 1]))
    else:
        _check_parallel(geometry, outward)
        angles[:, 0] = np.arctan2(outward[:, 1], outward[:, 0])
        dso = np.abs(np.einsum("vi,vi->v", geometry.panel_center, outward))
    turn = _euler(angles)
    center = np.einsum("vji,vj->vi", turn, geometry.panel_center)
    parallel = geometry.is_parallel
    return TigreGeometry(
        mode="parallel" if parallel else "cone",
        nDetector=(panel.rows, panel.columns),
        dDetector=(panel.row_pitch, panel.column_pitch),
        angles=angles,
        DSO=dso,
        DSD=dso - center[:, 0],
        offDetector=np.stack([zero, zero], axis=1) if parallel else center[:, [2, 1]],
        rotDetector=_fixed_axis_angles(np.einsum("vji,vjk->vik", turn, frame)),
        COR=center[:, 1] if parallel else zero,
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
    parallel = tigre.mode == "parallel"
    if parallel and np.any(tigre.angles[:, 1:]):
        raise GeometryError("TIGRE ignores theta and psi of a parallel beam: they must be 0")
    turn, (pitch_v, pitch_u) = _euler(tigre.angles), tigre.dDetector
    depth, (up, across) = tigre.DSO - tigre.DSD, tigre.offDetector.T
    shift = tigre.COR[:, None] * _about(tigre.angles[:, 0], 2)[:, :, 1]
    center = np.einsum("vij,vj->vi", turn, np.stack([depth, across, up], axis=1)) + shift
    panel = turn @ _about(tigre.rotDetector[:, 2], 2) @ _about(tigre.rotDetector[:, 1], 1)
    panel = panel @ _about(tigre.rotDetector[:, 0], 0)
    steps = center, pitch_u * panel[:, :, 1], -pitch_v * panel[:, :, 2]
    angles = np.ascontiguousarray(tigre.angles[:, 0])
    source = tigre.DSO[:, None] * turn[:, :, 0] + shift
    if parallel:  # each pixel has a source of its own, which does not move with the panel's offset
        return geometry_of(*steps, tigre.nDetector, ray_direction=center - source, angles=angles)
    return geometry_of(*steps, tigre.nDetector, source=source, angles=angles)


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


def _check_parallel(geometry: Geometry, outward: Float[np.ndarray, "view 3"]) -> None:
    """Refuse parallel beams that TIGRE has not: its beams turn about z only, and a shifted panel slants them."""
    slant = np.linalg.norm(geometry.ray_direction + outward, axis=1)
    if slant.max(initial=0) > _PERPENDICULAR:
        raise GeometryError(
            "TIGRE's parallel beam meets the panel at right angles, with columns and rows as ours: view "
            f"{slant.argmax()} is {np.rad2deg(2 * np.arcsin(min(slant.max() / 2, 1))):.6g} degrees off"
        )
    lean = np.abs(outward[:, 2])
    if lean.max(initial=0) > _PERPENDICULAR:
        raise GeometryError(
            f"TIGRE's parallel beam turns about the z axis only: that of view {lean.argmax()} leans "
            f"{np.rad2deg(np.arcsin(min(lean.max(), 1))):.6g} degrees out of the plane across it"
        )
    height = np.abs(geometry.panel_center[:, 2])
    if height.max(initial=0) > _LEVEL * min(geometry.panel.pitch):  # type: ignore[arg-type]
        raise GeometryError(
            f"TIGRE's parallel beam slants where its panel is shifted along z, as that of view {height.argmax()} is by "
            f"{height.max():.6g} mm: shift the volume"
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


def _fixed_axis_angles(turn: Turns) -> Float[np.ndarray, "view 3"]:
    """Angles (a, b, c) with Rz(c) Ry(b) Rx(a) = turn."""
    about_z = np.arctan2(turn[:, 1, 0], turn[:, 0, 0])
    rest = _about(-about_z, 2) @ turn
    about_x, about_y = np.arctan2(-rest[:, 1, 2], rest[:, 1, 1]), np.arctan2(-rest[:, 2, 0], rest[:, 0, 0])
    return np.stack([about_x, about_y, about_z], axis=1)
