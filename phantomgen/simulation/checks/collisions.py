"""Geometries that cannot be: an object in the place of the panel or beyond it, or behind the source."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.curved_panel import on_panel
from phantomgen.scene.scan import Scan
from phantomgen.shapes import Shape
from phantomgen.simulation.checks.field_of_view import named, reaching
from phantomgen.simulation.forward_model.sampled_rays import points_of
from spectra.errors import GeometryError

# Points of each object that are tested.
_POINTS = 1000
_TOUCH = 1e-6  # mm that an object may reach into the panel by rounding


def check_collisions(scan: Scan) -> None:
    """Refuse an object that a ray meets behind the panel, or that lies entirely behind the source of a view.

    An object that contains the source, such as a box of air around everything, may contain the panel, too. Objects
    beside the field of view may reach past the panel.

    Parameters
    ----------
    scan : the scan to check

    Raises
    ------
    GeometryError
        With object, view and distance.
    """
    frames = scan.by_module.geometry.ray_frames()
    for i, name, shape in named(scan, reaching(scan, _planes(frames))):
        for sentence in _collisions(scan, shape):
            raise GeometryError(f"object {i} ({name}) {sentence}")


def _planes(frames: Float[np.ndarray, "view 4 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Planes of panel and source, by normals towards what is between them and by offsets."""
    depth = np.linalg.inv(np.moveaxis(frames[:, 1:], 1, 2))[:, 0]
    normals = np.stack([depth, -depth], axis=1)
    offsets = -np.einsum("vpi,vi->vp", normals, frames[:, 0]) + [0.0, 1.0]
    return normals, offsets


def _collisions(scan: Scan, shape: Shape) -> Iterator[str]:
    """Yield sentences about an object in an impossible place, beginning with the worst views."""
    geometry, panel = scan.geometry, scan.geometry.panel
    points = np.concatenate(points_of(shape, _POINTS))
    if not len(points):
        return
    depth, column, row = np.moveaxis(on_panel(geometry, points), -1, 0)
    to_panel = np.abs(np.einsum("vi,vi->v", geometry.panel_center - geometry.source, geometry.normals()))
    nearest = (depth.max(axis=1) * to_panel).min(initial=np.inf)
    if nearest < 0:
        view = int((depth.max(axis=1) * to_panel).argmin())
        yield (
            f"lies behind the source in view {view}, by {_rounded(-nearest)} mm: move the object, "
            "or the source further out"
        )
    seen = (np.abs(column - (panel.columns - 1) / 2) < panel.columns / 2) & (
        np.abs(row - (panel.rows - 1) / 2) < panel.rows / 2
    )
    beyond = np.where(seen & (depth > 1), (depth - 1) * to_panel[:, None], 0.0).max(axis=1)
    beyond[shape.contains(geometry.source)] = 0.0
    if beyond.max() > _TOUCH:
        view = int(beyond.argmax())
        share = (beyond > _TOUCH).mean()
        yield (
            f"reaches {_rounded(beyond[view])} mm behind the panel in view {view}, and in {share:.0%} of "
            "the views: move the object, or the panel further out"
        )


def _rounded(length: float) -> str:
    """A length that sampled points tell to two digits."""
    return f"{float(f'{length:.2g}'):g}"
