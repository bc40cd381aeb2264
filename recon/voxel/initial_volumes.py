"""Volumes that a fit starts from, for any orbit: filtered back-projection where it is exact, OS-SART elsewhere."""

import numpy as np
from jaxtyping import Bool, Float

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.voxel.filtered.circular_orbit import circular_orbit_of
from recon.voxel.filtered.fdk import Fdk, fdk
from recon.voxel.iterative.sart import Sart
from recon.voxel.method import LinearMethod
from spectra.errors import GeometryError

SWEEPS = Sart(iterations=3)  # enough for the start of a fit; each costs two projections per view
_SAME_WAY = 0.02  # views whose central rays differ by less show no depth [rad]


def starting_method(geometry: Geometry, grid: Grid) -> LinearMethod:
    """Filtered back-projection for full circles, half-fans and short scans, and OS-SART for all else.

    Raises
    ------
    GeometryError
        When all views look the same way, which leaves depth open whatever the method.
    """
    check_directions(geometry)
    try:
        circular_orbit_of(geometry, grid)
    except GeometryError:
        return SWEEPS
    return Fdk("hann") if min(geometry.panel.rows, geometry.panel.columns) > 1 else SWEEPS


def initial_volumes(
    line_integrals: Float[np.ndarray, "view basis row column"],
    unseen: Bool[np.ndarray, "row column"],
    geometry: Geometry,
    grid: Grid,
    method: LinearMethod,
) -> Float[np.ndarray, "basis z y x"]:
    """Volumes of decomposed rays [1/mm].

    Parameters
    ----------
    line_integrals : of each view and basis; unseen pixels hold what their neighbours suggest
    unseen : pixels that measure too little
    geometry : poses of the views
    grid : the volume
    method : see `starting_method`
    """
    if isinstance(method, Fdk):
        return fdk(line_integrals, geometry, grid, method.window, method.cutoff)
    images = np.ascontiguousarray(np.moveaxis(line_integrals, 1, 0))
    seen = np.broadcast_to(~unseen, images.shape[1:]).astype(np.float32) if unseen.any() else None
    return method.reconstruct(images, seen, geometry, grid)


def check_directions(geometry: Geometry) -> None:
    """Refuse scans that cannot tell what is near from what is far.

    Raises
    ------
    GeometryError
        When there is one view only, or the rays through the middle of the panel have the same direction in all.
    """
    rays = geometry.panel_center - geometry.source
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    apart = np.linalg.norm(np.cross(rays, rays[:1]), axis=1).max(initial=0.0)
    if apart < _SAME_WAY:
        views = "1 view" if len(geometry) == 1 else f"{len(geometry)} views"
        raise GeometryError(
            f"a volume needs views from several sides, and the {views} of this scan look the same way within "
            f"{np.rad2deg(_SAME_WAY):.2g} degrees ({geometry.kind} geometry)"
        )
