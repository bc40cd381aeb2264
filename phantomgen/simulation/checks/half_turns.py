"""Points that a helix sees from too few directions to be reconstructed.

Along a helix every point leaves the panel in most views: that is how it is scanned. What matters is that rays through
the point have come from all directions within the half turn by which rays and their opposites repeat (the condition of
Orlov, and of Tuy 1983, doi:10.1137/0143035, in the plane of the turns).
"""

import numpy as np
from jaxtyping import Bool, Float

from phantomgen.geometry.poses import Geometry

# Directions that lack are a gap of more than so many steps between views, as the point sees them: half of the views
# are nearer to each other than the median, some by the ratio of the distances to the source.
_STEPS = 4.0
# A source that travels along the columns of the panel by more than this part of the panel's height runs on a helix.
_TRAVEL = 0.1
# Columns of all views point along the axis: the length of their mean direction is this at least.
_Z_ALIGNED = 0.999


def helix_axis(geometry: Geometry) -> Float[np.ndarray, " 3"] | None:
    """Return the axis along which the source travels as it turns.

    Parameters
    ----------
    geometry : poses

    Returns
    -------
    unit vector; None where the source does not travel, as on a circle
    """
    columns = geometry.row_step / np.linalg.norm(geometry.row_step, axis=1, keepdims=True)
    axis = columns.mean(axis=0)
    if np.linalg.norm(axis) < _Z_ALIGNED:
        return None
    axis /= np.linalg.norm(axis)
    height = geometry.panel.rows * geometry.panel.row_pitch
    return axis if np.ptp(geometry.source @ axis) > _TRAVEL * height else None


def lacks_directions(
    sources: Float[np.ndarray, "view 3"],
    axis: Float[np.ndarray, " 3"],
    points: Float[np.ndarray, "point 3"],
    seen: Bool[np.ndarray, "view point"],
) -> Bool[np.ndarray, " point"]:
    """Return the points that are seen over less than half a turn.

    Parameters
    ----------
    sources : where the rays of each view begin, most of them in the order of the turn [mm]
    axis : of the turn, a unit vector
    points : [mm]
    seen : whether the ray of a view to a point meets the panel

    Returns
    -------
    True for these points
    """
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first /= np.linalg.norm(first)
    rays = points[None] - sources[:, None]
    angle = np.arctan2(rays @ np.cross(axis, first), rays @ first)
    if len(angle) < 2:
        return np.ones(len(points), np.bool_)
    turned = np.abs((np.diff(angle, axis=0) + np.pi) % (2 * np.pi) - np.pi)
    folded = np.sort(np.where(seen, angle % np.pi, np.inf), axis=0)
    following = np.concatenate([folded[1:], np.full_like(folded[:1], np.inf)])
    following = np.where(np.isfinite(following), following, folded[:1] + np.pi)  # a half turn on, all comes again
    known = np.isfinite(folded)
    gaps = np.where(known, np.where(known, following, 0.0) - np.where(known, folded, 0.0), -np.inf)
    return ~known[0] | (gaps.max(axis=0) > _STEPS * np.median(turned, axis=0))
