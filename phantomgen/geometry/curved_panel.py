"""Curved panels as flat modules: their poses, their pixels, and points on them.

A view of a curved panel is computed as one view for each of its modules, side by side. So kernels know flat panels
only, and a curved panel is exact whatever they compute.
"""

from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int

from phantomgen.geometry.poses import Geometry
from spectra.errors import GeometryError

if TYPE_CHECKING:
    from torch import Tensor

    Array = TypeVar("Array", np.ndarray, Tensor)
else:
    Array = Any  # anything that can be reshaped


def flat_modules(geometry: Geometry) -> Geometry:
    """Return the poses of the modules of a curved panel as views of their own.

    Parameters
    ----------
    geometry : poses of a panel

    Returns
    -------
    for each view its modules in the order of their columns; the geometry itself where the panel is flat

    Raises
    ------
    GeometryError
        When a curved panel is wrapped past the source, or has none.
    """
    panel = geometry.panel
    if panel.curvature is None:
        return geometry
    if geometry.is_parallel:
        raise GeometryError("a curved panel needs a source, and a parallel beam has none: use a flat panel")
    away, radius = _away_from_source(geometry)[:, None], panel.curvature.radius
    along = (geometry.column_step / panel.column_pitch)[:, None]
    c, s = np.cos(panel.module_angles)[:, None], np.sin(panel.module_angles)[:, None]
    center = geometry.panel_center[:, None] + radius * ((c - 1) * away + s * along)
    step = panel.column_pitch * (c * along - s * away)
    height = np.einsum("vmi,vmi->vm", center - geometry.source[:, None], c * away + s * along)
    if len(height) and height.min() <= 0:
        view, module = np.unravel_index(height.argmin(), height.shape)
        raise GeometryError(
            f"the panel is wrapped past the source: module {module} of view {view} has the source behind it; give a "
            "larger radius or fewer columns"
        )
    return Geometry(
        source=np.repeat(geometry.source, panel.modules, axis=0),
        panel_center=center.reshape(-1, 3),
        column_step=step.reshape(-1, 3),
        row_step=np.repeat(geometry.row_step, panel.modules, axis=0),
        panel=panel.module,
        angles=np.repeat(geometry.angles, panel.modules),
        kind=geometry.kind,
    )


def module_frames(geometry: Geometry) -> Float[np.ndarray, "view module 4 3"]:
    """Compute the ray frames of all modules, as `Geometry.ray_frames` defines them.

    Parameters
    ----------
    geometry : poses of a panel, which may be flat and then has one module

    Returns
    -------
    frames, (view, module, 4, 3); columns count from the first one of each module
    """
    return flat_modules(geometry).ray_frames().reshape(len(geometry), geometry.panel.modules, 4, 3)


def split_modules(images: Array, modules: int, views: int = 0) -> Array:
    """Divide images of a curved panel into those of its modules.

    Parameters
    ----------
    images : (..., view, ..., row, column)
    modules : number of modules
    views : axis of the views

    Returns
    -------
    images, (..., view x module, ..., row, column)
    """
    if modules == 1:
        return images
    shape = images.shape
    parts: Any = images.reshape(*shape[:-1], modules, -1)
    for axis in range(parts.ndim - 2, views + 1, -1):
        parts = parts.swapaxes(axis, axis - 1)
    return parts.reshape(*shape[:views], shape[views] * modules, *shape[views + 1 : -1], -1)


def join_modules(images: Array, modules: int, views: int = 0) -> Array:
    """Put images of modules side by side.

    Parameters
    ----------
    images : (..., view x module, ..., row, column)
    modules : number of modules
    views : axis of the views

    Returns
    -------
    images of the whole panel, (..., view, ..., row, column)
    """
    if modules == 1:
        return images
    shape = images.shape
    parts: Any = images.reshape(*shape[:views], shape[views] // modules, modules, *shape[views + 1 :])
    for axis in range(views + 1, parts.ndim - 2):
        parts = parts.swapaxes(axis, axis + 1)
    return parts.reshape(*parts.shape[:-2], -1)


def on_panel(geometry: Geometry, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "view point 3"]:
    """Project points onto the panel in every view.

    Parameters
    ----------
    geometry : poses
    points : points [mm]

    Returns
    -------
    depth (0 at the source, 1 on the panel), column and row, (view, point, 3); of a curved panel those of the module
    whose middle is nearest, so that columns beyond the panel are those of its outer modules
    """
    frames, panel = module_frames(geometry), geometry.panel
    if panel.modules == 1:
        return on_plane(frames[:, 0], points)
    width = panel.columns // panel.modules
    nearest = np.full((len(frames), len(points)), np.inf)
    found = np.full((len(frames), len(points), 3), np.nan)
    for module in range(panel.modules):
        here = on_plane(frames[:, module], points)
        aside = np.where(here[..., 0] > 0, np.abs(here[..., 1] - (width - 1) / 2), np.inf)
        here[..., 1] += module * width
        closer = (aside < nearest) | np.isnan(found[..., 0])
        found[closer], nearest = here[closer], np.minimum(nearest, aside)
    return found


def sees(geometry: Geometry, points: Float[np.ndarray, "point 3"]) -> Bool[np.ndarray, "view point"]:
    """Say which views have which points on their panel.

    Parameters
    ----------
    geometry : poses
    points : points [mm]

    Returns
    -------
    whether the ray from the source through a point ends within the panel, (view, point); a curved panel counts as the
    arc itself, not as its flat modules
    """
    panel = geometry.panel
    if panel.curvature is None:
        depth, column, row = np.moveaxis(on_plane(geometry.ray_frames(), points), -1, 0)
        column, row = column - (panel.columns - 1) / 2, row - (panel.rows - 1) / 2
    else:
        depth, column, row = _on_arc(geometry, panel.curvature.radius, points)
    return (depth > 0) & (np.abs(column) <= panel.columns / 2) & (np.abs(row) <= panel.rows / 2)


def _on_arc(
    geometry: Geometry, radius: float, points: Float[np.ndarray, "point 3"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Project points onto an arc: depth, and column and row from the middle of the panel, (view, point) each."""
    panel, away = geometry.panel, _away_from_source(geometry)
    axes = np.stack([geometry.column_step / panel.column_pitch, away, geometry.row_step / panel.row_pitch], axis=1)
    source = np.einsum("vai,vi->av", axes, geometry.source - geometry.panel_center + radius * away)[..., None]
    ray = np.einsum("vai,vpi->avp", axes, points - geometry.source[:, None])
    square, product = (ray[:2] ** 2).sum(axis=0), (ray[:2] * source[:2]).sum(axis=0)
    past = (source[:2] ** 2).sum(axis=0) - radius**2
    with np.errstate(invalid="ignore", divide="ignore"):
        depth = (np.sqrt(product**2 - square * past) - product) / square  # nan for rays that miss the circle
        column = np.arctan2(source[0] + depth * ray[0], source[1] + depth * ray[1]) * (radius / panel.column_pitch)
        return 1 / depth, column, (source[2] + depth * ray[2]) / panel.row_pitch


def on_plane(
    frames: Float[np.ndarray, "view 4 3"], points: Float[np.ndarray, "point 3"]
) -> Float[np.ndarray, "view point 3"]:
    """Project points onto a plane of pixels in every view.

    Parameters
    ----------
    frames : source, vector to pixel (0, 0), column step and row step of each view [mm]
    points : points [mm], (point, 3)

    Returns
    -------
    depth (0 at the source, 1 on the panel), column and row, (view, point, 3)
    """
    inverse = np.linalg.inv(np.moveaxis(frames[:, 1:], 1, 2))
    scaled = np.einsum("vij,vpj->vpi", inverse, points[None] - frames[:, None, 0])
    depth = scaled[..., :1]
    return np.concatenate([depth, scaled[..., 1:] / np.where(depth == 0, 1.0, depth)], axis=-1)


def ray_directions(
    geometry: Geometry, columns: Float[np.ndarray, " column"], rows: Float[np.ndarray, " row"]
) -> Float[np.ndarray, "view row column 3"]:
    """Compute vectors from the source to points of the panel.

    Parameters
    ----------
    geometry : poses
    columns, rows : places on the panel, which may lie between the centres of pixels, and beyond the panel

    Returns
    -------
    vectors [mm], (view, row, column, 3)
    """
    frames, width = module_frames(geometry), geometry.panel.columns // geometry.panel.modules
    module = _modules(geometry, columns)
    along = frames[:, module, 1] + (columns - module * width)[:, None] * frames[:, module, 2]
    return along[:, None] + rows[:, None, None] * frames[:, module, 3][:, None]


def pixel_areas(geometry: Geometry, columns: Float[np.ndarray, " column"]) -> Float[np.ndarray, "view column 3"]:
    """Compute normals of pixels, as long as the area of a pixel.

    Parameters
    ----------
    geometry : poses
    columns : places on the panel, which may lie between the centres of pixels

    Returns
    -------
    vectors [mm^2], (view, column, 3); they are the same in all rows
    """
    frames = module_frames(geometry)[:, _modules(geometry, columns)]
    return np.cross(frames[:, :, 2], frames[:, :, 3])


def panel_edges(geometry: Geometry, view: int) -> Float[np.ndarray, "edge point 3"]:
    """Return points on the outer edges of the panel before its first row and behind its last one.

    Parameters
    ----------
    geometry : poses
    view : number of the view

    Returns
    -------
    points [mm], (2, point, 3): both ends of each edge, from the first to the last column, and where modules meet
    """
    modules = flat_modules(geometry[[view]])
    columns = modules.column_step * modules.panel.columns / 2
    middle = np.concatenate([modules.panel_center[:1] - columns[:1], modules.panel_center + columns])
    rows = geometry.row_step[view] * geometry.panel.rows / 2
    return np.stack([middle - rows, middle + rows])


def shifted_along(geometry: Geometry, distance: float) -> Geometry:
    """Shift a panel the way its columns count; a curved one moves along its cylinder.

    Parameters
    ----------
    geometry : poses
    distance : along the columns' steps [mm]

    Returns
    -------
    poses with the shifted panel, the source where it was
    """
    curvature, along = geometry.panel.curvature, geometry.column_step / geometry.panel.column_pitch
    if curvature is None:
        return replace(geometry, panel_center=geometry.panel_center + distance * along)
    away, angle = _away_from_source(geometry), distance / curvature.radius
    c, s = np.cos(angle), np.sin(angle)
    return replace(
        geometry,
        panel_center=geometry.panel_center + curvature.radius * ((c - 1) * away + s * along),
        column_step=geometry.panel.column_pitch * (c * along - s * away),
    )


def _modules(geometry: Geometry, columns: Float[np.ndarray, " column"]) -> Int[np.ndarray, " column"]:
    """Module of each place; beyond the panel, the outer one."""
    width = geometry.panel.columns // geometry.panel.modules
    return np.clip(np.floor((columns + 0.5) / width), 0, geometry.panel.modules - 1).astype(np.int64)


def _away_from_source(geometry: Geometry) -> Float[np.ndarray, "view 3"]:
    """Unit normals of the middle of the panel that point away from the source."""
    normal = geometry.normals()
    return normal * np.sign(np.einsum("vi,vi->v", normal, geometry.panel_center - geometry.source))[:, None]
