"""Resampling of images from a curved panel to a flat one that touches it in its middle."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.ndimage import map_coordinates

from phantomgen.geometry.curved_panel import on_panel, ray_directions
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry

_SAME = 1e-6  # mm; views whose source and panel lie to each other as in the view before are resampled alike


def flat_equivalent(geometry: Geometry) -> Geometry:
    """Return poses of a flat panel that sees all rays to a curved one.

    Parameters
    ----------
    geometry : poses of a panel

    Returns
    -------
    poses of a flat panel in the plane that touches the curved one in its middle, with the same pitch there; the
    geometry itself where the panel is flat
    """
    panel = geometry.panel
    if panel.curvature is None:
        return geometry
    columns, rows = np.array([-0.5, panel.columns - 0.5]), np.array([-0.5, panel.rows - 0.5])
    rays = ray_directions(geometry, columns, rows)
    axes = np.stack([geometry.column_step, geometry.row_step, geometry.panel_center - geometry.source], axis=-1)
    across, along, depth = np.moveaxis(np.linalg.solve(axes[:, None, None], rays[..., None])[..., 0], -1, 0)
    half = [int(np.ceil(np.abs(part / depth).max() - 1e-6)) for part in (along, across)]
    return replace(geometry, panel=Panel(2 * half[0], 2 * half[1], panel.pitch))


def on_flat_panel(
    images: Float[np.ndarray, "view basis row column"], geometry: Geometry, flat: Geometry | None = None
) -> tuple[Float[np.ndarray, "view basis new_row new_column"], Geometry]:
    """Resample images to a flat panel.

    A line integral belongs to a ray and not to a panel, so each pixel of the flat panel takes the value where its ray
    meets the curved one, by cubic splines; pixels beyond take the value at the border.

    Parameters
    ----------
    images : line integrals on the curved panel [no unit]
    geometry : poses of the curved panel
    flat : poses of the flat panel; left out, those of `flat_equivalent`

    Returns
    -------
    images on the flat panel, and its geometry
    """
    flat = flat_equivalent(geometry) if flat is None else flat
    if flat is geometry:
        return images, geometry
    rows, columns = np.arange(float(flat.panel.rows)), np.arange(float(flat.panel.columns))
    out = np.empty((*images.shape[:2], len(rows), len(columns)), np.float32)
    known, places = np.full((3, 3), np.inf), np.empty(0)
    for view in range(len(geometry)):
        one = geometry[[view]]
        relation = _relation(one)
        if np.abs(relation - known).max() > _SAME:
            points = one.source + ray_directions(flat[[view]], columns, rows).reshape(-1, 3)
            places = on_panel(one, points)[0, :, [2, 1]].reshape(2, len(rows), len(columns))
            known = relation
        for basis, image in enumerate(images[view]):
            out[view, basis] = map_coordinates(image, places, order=3, mode="nearest")
    return out, flat


def _relation(one: Geometry) -> Float[np.ndarray, "3 3"]:
    """Lengths and scalar products of the vectors that say how source and panel of a view lie to each other."""
    vectors = np.concatenate([one.column_step, one.row_step, one.panel_center - one.source])
    return vectors @ vectors.T
