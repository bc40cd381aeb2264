"""Initial volumes of a fit, for any orbit: filtered back-projection where the orbit allows it, OS-SART elsewhere."""

import numpy as np
from jaxtyping import Bool, Float

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.voxel.filtered.circular_orbit import circular_orbit_of
from recon.voxel.filtered.fdk import Fdk, fdk
from recon.voxel.iterative.sart import Sart
from recon.voxel.method import LinearMethod
from spectra.errors import GeometryError

# OS-SART in three passes, which suffice for the start of a fit; each costs two projections per view; chosen by hand
STARTING_SART = Sart(iterations=3)
_PARALLEL = 0.02  # rad; views whose central rays differ by less show no depth; chosen by hand, not measured


def starting_method(geometry: Geometry, grid: Grid) -> LinearMethod:
    """Choose filtered back-projection for full circles, half-fans and short scans, and OS-SART for all other orbits.

    Parameters
    ----------
    geometry : poses of the views
    grid : the volume to reconstruct

    Returns
    -------
    the method

    Raises
    ------
    GeometryError
        When all views have the same direction, which leaves depth undetermined by any method.
    """
    check_directions(geometry)
    try:
        circular_orbit_of(geometry, grid)
    except GeometryError:
        return STARTING_SART
    return Fdk("hann") if min(geometry.panel.rows, geometry.panel.columns) > 1 else STARTING_SART


def initial_volumes(
    line_integrals: Float[np.ndarray, "view basis row column"],
    unseen: Bool[np.ndarray, "row column"],
    geometry: Geometry,
    grid: Grid,
    method: LinearMethod,
) -> Float[np.ndarray, "basis z y x"]:
    """Reconstruct volumes from decomposed rays.

    Parameters
    ----------
    line_integrals : one image per view and basis; unseen pixels are interpolated from their neighbours [no unit]
    unseen : pixels with too few measuring channels
    geometry : poses of the views
    grid : the volume to reconstruct
    method : see `starting_method`

    Returns
    -------
    volumes of the bases [1/mm]
    """
    if isinstance(method, Fdk):
        return fdk(line_integrals, geometry, grid, method.window, method.cutoff)
    images = np.ascontiguousarray(np.moveaxis(line_integrals, 1, 0))
    seen = np.broadcast_to(~unseen, images.shape[1:]).astype(np.float32) if unseen.any() else None
    return method.reconstruct(images, seen, geometry, grid)


def check_directions(geometry: Geometry) -> None:
    """Refuse scans that do not determine depth.

    Parameters
    ----------
    geometry : poses of the views

    Raises
    ------
    GeometryError
        When there is one view only, or the rays through the middle of the panel have the same direction in all views.
    """
    rays = geometry.panel_center - geometry.source
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    apart = np.linalg.norm(np.cross(rays, rays[:1]), axis=1).max(initial=0.0)
    if apart < _PARALLEL:
        views = "1 view" if len(geometry) == 1 else f"{len(geometry)} views"
        raise GeometryError(
            f"a volume needs views from several sides, and the {views} of this scan have the same direction within "
            f"{np.rad2deg(_PARALLEL):.2g} degrees ({geometry.kind} geometry)"
        )
