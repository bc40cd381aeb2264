"""What the scan can see of the scene: where points of the objects fall on the panel, and the rays through them."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float

from phantomgen.ops.primitives import BALL, CYLINDER
from phantomgen.ops.trace import trace
from phantomgen.panel import Panel
from phantomgen.scene import Scan
from phantomgen.shapes import Shape

_POINTS = 500
_RAYS_PER_OBJECT = 40


def coverage_warnings(scan: Scan) -> list[str]:
    """Sentences about objects that the panel or the volume cuts off, with how much of them."""
    return [*_panel_warnings(scan), *_volume_warnings(scan)]


def sampled_lengths(scan: Scan) -> Float[np.ndarray, "ray material"]:
    """Path lengths per material [mm] of rays through every object in every view."""
    targets = np.concatenate([_points(shape, _RAYS_PER_OBJECT)[0] for shape, _ in scan.scene.objects])
    shapes, frames = scan.scene.arrays, scan.geometry.ray_frames()
    to_target = targets[None] - frames[:, None, 0]
    depth = _on_panel(frames, targets)[..., 0]
    in_front = depth > 1e-6
    directions = to_target[in_front] / depth[in_front][:, None]
    origins = np.broadcast_to(frames[:, None, 0], to_target.shape)[in_front]
    return trace(origins, directions, shapes.kinds, shapes.locals_, shapes.materials, len(scan.scene.materials))


def _panel_warnings(scan: Scan) -> Iterator[str]:
    """Objects that leave the panel in some view."""
    frames, panel = scan.geometry.ray_frames(), scan.geometry.panel
    for i, (shape, material) in enumerate(scan.scene.objects):
        inside, surface = _points(shape, _POINTS)
        outside, beyond = _missed(frames, surface, panel)
        if not outside.any():
            continue
        share = _missed(frames, inside, panel)[0].any(axis=0).mean()
        views = outside.any(axis=1).mean()
        yield (
            f"object {i} ({scan.scene.materials[material].name}) leaves the panel's field of view in {views:.0%} of "
            f"the views: {share:.1%} of its volume is cut off in some view, by up to {beyond:.3g} mm on the panel"
        )


def _volume_warnings(scan: Scan) -> Iterator[str]:
    """Objects that reach beyond the grid of the truth."""
    grid = scan.grid
    low = np.array([grid.origin[i] - grid.spacing[i] / 2 for i in (2, 1, 0)])
    high = low + np.array([grid.shape[i] * grid.spacing[i] for i in (2, 1, 0)])
    for i, (shape, material) in enumerate(scan.scene.objects):
        lowest, highest = shape.bounds
        beyond = max((low - lowest).max(), (highest - high).max())
        if beyond > 1e-9:
            inside, _ = _points(shape, _POINTS)
            share = ((inside < low) | (inside > high)).any(axis=1).mean()
            yield (
                f"object {i} ({scan.scene.materials[material].name}) reaches {beyond:.3g} mm beyond the volume: "
                f"{share:.1%} of it has no truth there"
            )


def _missed(
    frames: Float[np.ndarray, "view 4 3"],
    points: Float[np.ndarray, "point 3"],
    panel: Panel,
) -> tuple[Bool[np.ndarray, "view point"], float]:
    """Which points no pixel sees (also those behind the source), and the largest distance beyond the panel [mm]."""
    depth, column, row = np.moveaxis(_on_panel(frames, points), -1, 0)
    beyond = np.maximum(
        np.maximum(-0.5 - column, column - (panel.columns - 0.5)) * panel.column_pitch,
        np.maximum(-0.5 - row, row - (panel.rows - 0.5)) * panel.row_pitch,
    )
    unseen = ~((depth > 0) & (depth <= 1))
    return unseen | (beyond > 1e-9), float(beyond[~unseen].max(initial=0.0))


def _on_panel(
    frames: Float[np.ndarray, "view 4 3"], points: Float[np.ndarray, "point 3"]
) -> Float[np.ndarray, "view point 3"]:
    """Depth (0 at the source, 1 on the panel), column and row of points in every view."""
    inverse = np.linalg.inv(np.moveaxis(frames[:, 1:], 1, 2))
    scaled = np.einsum("vij,vpj->vpi", inverse, points[None] - frames[:, None, 0])
    depth = scaled[..., :1]
    return np.concatenate([depth, scaled[..., 1:] / np.where(depth == 0, 1.0, depth)], axis=-1)


def _points(shape: Shape, count: int) -> tuple[Float[np.ndarray, "point 3"], Float[np.ndarray, "point 3"]]:
    """Points spread evenly inside a shape, its centre first, and the same pushed out to its surface."""
    unit = np.random.default_rng(0).uniform(-1, 1, (4 * count, 3))
    radial = np.linalg.norm(unit[:, :2], axis=1)
    gauge = {BALL: np.linalg.norm(unit, axis=1), CYLINDER: np.maximum(radial, np.abs(unit[:, 2]))}.get(
        shape.KIND, np.abs(unit).max(axis=1)
    )
    kept = np.flatnonzero(gauge < 1)[:count]
    inside = np.concatenate([np.zeros((1, 3)), unit[kept]])
    surface = unit[kept] / gauge[kept, None]
    center = np.asarray(shape.center)
    return inside @ shape.axes.T + center, surface @ shape.axes.T + center
