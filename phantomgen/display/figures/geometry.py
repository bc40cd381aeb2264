"""A picture of a scan's geometry: from above, from the side, and the panel as the source sees it."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from phantomgen.display.figures.style import BLACK, GRID, RED, check_picture, styled_figure
from phantomgen.geometry.curved_panel import module_frames, on_panel, panel_edges, ray_directions
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.runtime.disk import complete_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BLUE, FAN, VOLUME = "#0072B2", "#E69F00", "0.45"
_MOST_PANELS = 60  # panels that are drawn faintly beside that of view 0
Points = Float[np.ndarray, "point 3"]
Flat = Float[np.ndarray, "point 2"]


@dataclass(frozen=True, eq=False)
class _Side:
    """A direction to look from, as the two axes of the picture."""

    title: str
    across: Float[np.ndarray, " 3"]
    up: Float[np.ndarray, " 3"]
    labels: tuple[str, str]

    def flat(self, points: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 2"]:
        """Points as they are drawn."""
        return np.stack([points @ self.across, points @ self.up], axis=-1)


def draw(
    geometry: Geometry, path: Path | str | None = None, grid: Grid | None = None, stacked: bool = False
) -> "Figure":
    """Draw a scan: path of source and panel, and view 0 with its fan.

    Parameters
    ----------
    geometry : with at least one view
    path : PNG, PDF or SVG to write; none is written where left out
    grid : a volume to draw with it
    stacked : one below the other, for a narrow page, in place of side by side

    Returns
    -------
    the figure
    """
    if path is not None:
        check_picture(Path(path))
    source = drawn_sources(geometry, grid)
    beam = geometry.panel_center[0] - source[0]
    level = np.array([beam[0], beam[1], 0.0])
    along = -level / max(np.linalg.norm(level), 1e-9)
    sides = (
        _Side("from above", np.eye(3)[0], np.eye(3)[1], ("x [mm]", "y [mm]")),
        _Side("from the side of view 0", along, np.eye(3)[2], ("towards the source [mm]", "z [mm]")),
    )
    with styled_figure((4.7, 9.0) if stacked else (11.0, 4.3)) as figure:
        if stacked:
            above, beside, panel = figure.subplots(3, 1)
        else:
            above, beside, panel = figure.subplots(1, 3, width_ratios=(1.15, 1.15, 1.0))
        for axes, side in zip((above, beside), sides, strict=True):
            _draw_side(axes, side, geometry, source, grid)
        turn, radius = np.linspace(0, 2 * np.pi, 181), field_of_view(geometry)
        if radius > 0:
            label = "seen in all views"
            above.plot(radius * np.cos(turn), radius * np.sin(turn), color=BLUE, linestyle=(0, (4, 2)), label=label)
        _draw_panel(panel, geometry, grid)
        if not stacked:
            figure.suptitle(_title(geometry), fontsize=10.5)
        handles, labels = above.get_legend_handles_labels()
        columns = 2 if stacked else len(labels)
        figure.legend(handles, labels, loc="outside lower center", ncols=columns, fontsize=8.5)
        if path is not None:
            with complete_file(Path(path), Path(path).suffix) as beside:
                figure.savefig(beside, transparent=stacked)
    return figure


def drawn_sources(geometry: Geometry, grid: Grid | None) -> Points:
    """Return the source of each view as it is drawn.

    In a parallel beam it is a point on the central ray, at a distance before the axis that depends on the size of the
    drawing.

    Parameters
    ----------
    geometry : poses
    grid : volume in the drawing

    Returns
    -------
    points [mm], (view, 3)
    """
    if geometry.ray_direction is None:
        return geometry.source
    panel = geometry.panel
    diagonal = np.hypot(panel.rows * panel.row_pitch, panel.columns * panel.column_pitch)
    size = 0.0 if grid is None else float(max(np.multiply(grid.shape, grid.spacing)))
    ahead = np.einsum("vi,vi->v", geometry.panel_center, geometry.ray_direction)
    return geometry.panel_center - (ahead + max(diagonal, size))[:, None] * geometry.ray_direction


def field_of_view(geometry: Geometry) -> float:
    """Compute the radius of the field of view in the panel's middle row.

    Rays to the middle row pass by this circle about the rotation axis on both sides in every view. The radius is 0
    where the panel does not contain the axis in some view.

    Parameters
    ----------
    geometry : poses

    Returns
    -------
    radius [mm]
    """
    panel, source = geometry.panel, module_frames(geometry)[:, 0, 0]
    ends, middle = np.array([-0.5, panel.columns - 0.5]), np.array([(panel.rows - 1) / 2])
    rays = ray_directions(geometry, ends, middle)[:, 0]
    moments = source[:, :1] * rays[..., 1] - source[:, 1:2] * rays[..., 0]
    left, right = (moments / np.maximum(np.hypot(rays[..., 0], rays[..., 1]), 1e-9)).T
    covers_axis = np.sign(left) != np.sign(right)
    return float(np.where(covers_axis, np.minimum(np.abs(left), np.abs(right)), 0.0).min())


def _title(geometry: Geometry) -> str:
    """The scan in one line."""
    panel = geometry.panel
    pitch = (
        f"{panel.row_pitch:g}"
        if panel.row_pitch == panel.column_pitch
        else f"{panel.row_pitch:g} x {panel.column_pitch:g}"
    )
    views = f"{len(geometry)} view{'s' if len(geometry) > 1 else ''}"
    curved = "" if panel.curvature is None else f" on a radius of {panel.curvature.radius:g} mm"
    return f"{geometry.kind} geometry: {views}, {panel.rows} x {panel.columns} pixels of {pitch} mm{curved}"


def _panel_outline(geometry: Geometry, view: int) -> Points:
    """Outer edges of the panel, closed."""
    first, last = panel_edges(geometry, view)
    return np.concatenate([first, last[::-1], first[:1]])


def _draw_side(axes: "Axes", side: _Side, geometry: Geometry, source: Points, grid: Grid | None) -> None:
    """The scan from one side."""
    outline = _panel_outline(geometry, 0)
    for view in np.unique(np.linspace(0, len(geometry) - 1, _MOST_PANELS).astype(int))[1:]:
        axes.plot(*side.flat(_panel_outline(geometry, int(view))).T, color=BLUE, alpha=0.13, linewidth=0.7)
    ways = side.flat(source)
    start = "beam comes from" if geometry.is_parallel else "source"
    order = {"c": np.arange(len(ways)), "cmap": "YlOrRd", "vmin": -0.6 * len(ways), "s": 9}
    axes.scatter(*ways.T, **order, zorder=3, label=f"{start}, first to last view")
    starts = source[:1] if not geometry.is_parallel else outline + (source[0] - geometry.panel_center[0])
    fan = np.concatenate([side.flat(starts), side.flat(outline)])
    axes.fill(*_hull(fan).T, color=FAN, alpha=0.22, linewidth=0, label="rays, view 0")
    axes.plot(*side.flat(np.stack([source[0], geometry.panel_center[0]])).T, color=FAN, linewidth=0.9)
    axes.plot(*side.flat(outline).T, color=BLUE, linewidth=2.2, solid_joinstyle="miter", label="panel, view 0")
    axes.plot(*ways[0], "o", color=RED, markersize=7, zorder=4, label=f"{start}, view 0")
    if grid is not None:
        axes.fill(*_hull(side.flat(_box(grid))).T, facecolor="none", edgecolor=VOLUME, linewidth=1.2, label="volume")
    axes.plot(0, 0, "+", color=BLACK, markersize=8, label="isocentre", zorder=5)
    axes.set(title=side.title, xlabel=side.labels[0], ylabel=side.labels[1])
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(color=GRID, linewidth=0.5)
    axes.set_axisbelow(True)


def _draw_panel(axes: "Axes", geometry: Geometry, grid: Grid | None) -> None:
    """The panel of view 0 as the source sees it, in columns and rows, with what falls on it."""
    panel = geometry.panel
    right, bottom = panel.columns - 0.5, panel.rows - 0.5
    edge = np.array([[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom], [-0.5, -0.5]])
    axes.fill(*edge.T, color=BLUE, alpha=0.08, linewidth=0)
    axes.plot(*edge.T, color=BLUE, linewidth=2.2)
    if grid is not None:
        seen = _on_panel(geometry, _box(grid))
        if len(seen) == 8:
            axes.fill(*_hull(seen).T, facecolor="none", edgecolor=VOLUME, linewidth=1.2)
    reach = 0.5 * panel.rows * panel.row_pitch
    axis = _on_panel(geometry, np.outer(np.linspace(-reach, reach, 50), [0.0, 0.0, 1.0]))
    axes.plot(*axis.T, color=BLACK, linewidth=0.9, linestyle=(0, (5, 3)))
    if len(axis):
        axes.annotate("rotation axis", axis[-1], (4, -10), textcoords="offset points", fontsize=7.5, color="0.3")
    axes.plot(*_on_panel(geometry, np.zeros((1, 3))).T, "+", color=BLACK, markersize=8)
    axes.plot(0, 0, "s", color=RED, markersize=4)
    axes.annotate("pixel (0, 0)", (0, 0), (5, -11), textcoords="offset points", fontsize=7.5, color="0.3")
    axes.set(title="panel of view 0, from the source", xlabel="column", ylabel="row")
    axes.set_aspect(panel.row_pitch / panel.column_pitch, adjustable="datalim")
    axes.margins(0.08)
    axes.invert_yaxis()
    axes.grid(color=GRID, linewidth=0.5)
    axes.set_axisbelow(True)


def _on_panel(geometry: Geometry, points: Points) -> Flat:
    """Column and row that points in front of the source fall on in view 0."""
    depth, column, row = on_panel(geometry[[0]], points)[0].T
    return np.stack([column, row], axis=1)[depth > 0]


def _box(grid: Grid) -> Points:
    """Corners of a volume, outer edges of its voxels [mm]."""
    low = np.array(grid.origin) - np.array(grid.spacing) / 2
    ends = np.stack([low, low + np.multiply(grid.shape, grid.spacing)])[:, ::-1]
    return np.stack(np.meshgrid(*ends.T, indexing="ij"), axis=-1).reshape(-1, 3)


def _hull(points: Flat) -> Float[np.ndarray, "corner 2"]:
    """Corners of the convex hull, in order; the points themselves where they lie on a line."""
    from scipy.spatial import ConvexHull, QhullError  # noqa: PLC0415 - only where something is drawn

    try:
        return points[ConvexHull(points).vertices]
    except QhullError:
        return points
