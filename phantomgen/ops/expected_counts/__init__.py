"""Expected counts of one view, averaged over the area of each pixel.

A pixel averages *intensities*, not line integrals. Where nothing happens inside a pixel, one ray and the curvature over
its neighbours give the average; where a silhouette passes, the pixel is split along it. `expected_counts_by_grid` is
the same average over a plain n x n grid of rays.

Accuracy, as the largest error of a log-projection against 256 x 256 rays per pixel: 3e-5 where silhouettes cross, rms
4e-6 (four nested cylinders, 0.8 mm pixels). Split exactly are the silhouettes of single shapes. Where surfaces of two
shapes intersect, edges of a mesh pass, or panel or source cut a shape, counts have a kink: there, the pixel is halved
into rectangles until their estimated errors come to less than `INTERSECTION_TOLERANCE`; true ones are about half as
large, see `benchmarks/simulator/intersection_pixels.py`.
"""

from itertools import pairwise
from math import ceil
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int64, UInt8

from phantomgen.ops.expected_counts.pixel_classes import CLASSES, CROSSED, EMPTY, INTERSECTED, NEAR, SMOOTH, VOXELS
from phantomgen.ops.mesh import mesh_view
from phantomgen.ops.solids import Solids
from phantomgen.ops.voxel_maps import VoxelMaps
from spectra.errors import InputError

__all__ = [
    "CLASSES",
    "CROSSED",
    "EMPTY",
    "INTERSECTED",
    "INTERSECTION_TOLERANCE",
    "NEAR",
    "SMOOTH",
    "VOXELS",
    "ExpectedCounts",
    "expected_counts",
    "expected_counts_by_grid",
]


# Gauss nodes across and along a silhouette for pixels of growing contrast.
RULES = ((2, 2), (3, 2), (4, 3), (6, 4), (9, 6))
MOST_SUB_RAYS = 16
# Error of log counts that is left in pixels where surfaces intersect.
INTERSECTION_TOLERANCE = 3e-4
# Where a voxel map projects to: rays per voxel along each side of a pixel, and most rays along it.
RAYS_PER_VOXEL, MOST_RAYS = 4.0, 64


class ExpectedCounts(NamedTuple):
    """Expected counts of a view, the class of each pixel, and how many rays each class took."""

    counts: Float[np.ndarray, "channel row column"]
    classes: UInt8[np.ndarray, "row column"]
    rays: Int64[np.ndarray, " class"]


def expected_counts(
    frame: Float[np.ndarray, "4 3"],
    rows: int,
    columns: int,
    solids: Solids,
    attenuation: Float[np.ndarray, "material node"],
    weights: Float[np.ndarray, " node"],
    starts: Int64[np.ndarray, " boundary"],
    background: int = -1,
    rules: tuple[tuple[int, int], ...] = RULES,
    reach: float = 5.0,
    sub_rays: int | None = None,
    intersection_tolerance: float = INTERSECTION_TOLERANCE,
    rays_per_voxel: float = RAYS_PER_VOXEL,
    profile: Float[np.ndarray, "part row column"] | None = None,
    aperture: tuple[float, float] = (1.0, 1.0),
) -> ExpectedCounts:
    """Expected counts of all pixels of one view, each averaged over the pixel's area.

    Parameters
    ----------
    frame : source, vector from there to the centre of pixel (0, 0), column step, row step (x, y, z) [mm]
    rows, columns : size of the panel
    solids : the objects, lowest priority first
    attenuation : linear attenuation of each material at each spectral node [1/mm]
    weights : photons times response at each node
    starts : channel c owns the nodes ``starts[c]`` to ``starts[c + 1]``
    background : material outside all shapes, -1 for none
    rules : Gauss nodes across and along a silhouette, per smooth part of a pixel, for growing contrast
    reach : width of the band inside a tangent where one ray per pixel does not do [pixel]
    sub_rays : if given, a plain grid of so many rays along each edge of a pixel, 1 to 16, in place of Gauss nodes along
        silhouettes; 1 means the ray through the centre of every pixel and nothing else
    intersection_tolerance : estimated error of log counts that is left where surfaces intersect, in the worst channel
    rays_per_voxel : where a voxel map projects to, rays along each edge of a pixel for each voxel that fits there; a
        pixel has at least as many along an edge, and at most `MOST_RAYS`
    profile : lengths [mm] that the rays to each pixel have, objects aside, in the last materials of `attenuation`; the
        same for all rays to a pixel
    aperture : width and height of the sensitive part of a pixel, which the average is taken over [pixel]
    """
    from phantomgen.ops.expected_counts.cpu import expected_counts_of_view  # noqa: PLC0415 - numba only where it computes
    from phantomgen.ops.expected_counts.rectangles import scratch  # noqa: PLC0415
    from phantomgen.ops.silhouette.quadrature import make_room, make_rules  # noqa: PLC0415

    if sub_rays is not None and not 1 <= sub_rays <= MOST_SUB_RAYS:
        raise InputError(f"sub-rays along the edge of a pixel must be 1 to {MOST_SUB_RAYS}, got {sub_rays}")
    if not intersection_tolerance > 0:
        raise InputError(
            f"the tolerance of pixels where surfaces intersect must be positive, got {intersection_tolerance:g}"
        )
    view = _View.of(
        frame,
        rows,
        columns,
        solids,
        attenuation,
        weights,
        starts,
        background,
        sub_rays != 1,
        profile,
        rays_per_voxel,
    )
    gauss, pixels = make_rules(*rules), (rows, columns)
    room = make_room(gauss)
    out, rays = np.empty((len(starts) - 1, *pixels)), np.zeros(CLASSES, dtype=np.int64)
    classes, guess = np.empty(pixels, dtype=np.uint8), np.zeros(pixels, dtype=np.uint8)
    maps = (classes, guess, np.zeros(pixels, dtype=np.int64), np.empty((rows * columns, 5), dtype=np.int64))
    outline = (view.outline.forms, view.outline.shapes, view.outline.roots)
    expected_counts_of_view(
        *view.shapes[:4],
        view.creases,
        view.shapes[4],
        np.int64(view.map_grid),
        *view.shapes[5:],
        outline,
        float(reach) / min(aperture),  # whose forms are measured in apertures, while neighbours are pixels away
        (float(aperture[0]), float(aperture[1])),
        sub_rays or 0,
        view.spectrum,
        tuple(gauss),
        (*room, np.empty(len(room.nodes), dtype=np.int64)),
        view.ray,
        maps,
        (
            0.0 if sub_rays else float(intersection_tolerance),
            (float(aperture[0]), float(aperture[1])),
            *scratch(len(out)),
        ),
        np.empty_like(out),
        out,
        rays,
    )
    return ExpectedCounts(out, classes, rays)


def expected_counts_by_grid(
    frame: Float[np.ndarray, "4 3"],
    pixels: Int64[np.ndarray, "pixel 2"],
    solids: Solids,
    attenuation: Float[np.ndarray, "material node"],
    weights: Float[np.ndarray, " node"],
    starts: Int64[np.ndarray, " boundary"],
    background: int = -1,
    n: int = 256,
    profile: Float[np.ndarray, "part row column"] | None = None,
    aperture: tuple[float, float] = (1.0, 1.0),
    lattice: bool = False,
) -> Float[np.ndarray, "pixel channel"]:
    """Expected counts of some pixels (row, column), each the mean over n^2 rays.

    Rays go through a grid of midpoints or, with `lattice`, through as many points of a lattice, no two of them in a row
    or column: beside edges along rows the grid errs by up to 1 / (2 n) of a pixel, the lattice by 1 / (2 n^2). The
    other parameters are those of `expected_counts`.
    """
    from phantomgen.ops.expected_counts.cpu import expected_counts_of_pixels  # noqa: PLC0415
    from phantomgen.ops.silhouette.quadrature import lattice_step  # noqa: PLC0415

    pixels = np.ascontiguousarray(pixels, dtype=np.int64)
    rows, columns = (pixels.max(axis=0, initial=0) + 1).tolist()
    profile = profile if profile is None else profile[:, :rows, :columns]
    view = _View.of(frame, rows, columns, solids, attenuation, weights, starts, background, False, profile)
    out = np.empty((len(starts) - 1, rows, columns))
    index = np.arange(n * n)
    if lattice:
        where = [(index + 0.5) / n**2, (index * lattice_step(n * n) % n**2 + 0.5) / n**2]
    else:
        where = [(index % n + 0.5) / n, (index // n + 0.5) / n]
    across, down = aperture
    grid = np.stack([across * (where[0] - 0.5), down * (where[1] - 0.5), np.full(n * n, 1 / n**2)], axis=1)
    scratch = (np.empty((1, 5), dtype=np.int64), np.empty(n * n, dtype=np.int64))
    expected_counts_of_pixels(*view.shapes, view.spectrum, grid, view.ray, pixels, scratch, out)
    return out[:, pixels[:, 0], pixels[:, 1]].T


class _View(NamedTuple):
    """Arguments of one view as the kernels want them."""

    shapes: tuple[np.ndarray, np.ndarray, np.ndarray | None, Any, Any, tuple, int, np.ndarray | None]
    creases: np.ndarray | None
    map_grid: int
    outline: Any
    spectrum: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
    ray: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]

    @classmethod
    def of(
        cls,
        frame: np.ndarray,
        rows: int,
        columns: int,
        solids: Solids,
        attenuation: np.ndarray,
        weights: np.ndarray,
        starts: np.ndarray,
        background: int,
        with_silhouettes: bool,
        profile: np.ndarray | None,
        rays_per_voxel: float = RAYS_PER_VOXEL,
    ) -> "_View":
        """Check and arrange the arguments of `expected_counts`; without silhouettes where no rule asks for them."""
        from phantomgen.ops.silhouette.forms import (  # noqa: PLC0415
            Silhouettes,
            cone_bounds,
            cone_silhouettes,
            no_silhouettes,
        )
        from phantomgen.ops.silhouette.tiles import Tiles  # noqa: PLC0415
        from phantomgen.ops.trace.cpu import event_room  # noqa: PLC0415
        from phantomgen.ops.trace.table import ring_tubes, solid_table  # noqa: PLC0415

        frame, attenuation, weights = (np.ascontiguousarray(a, dtype=np.float64) for a in (frame, attenuation, weights))
        starts = np.ascontiguousarray(starts, dtype=np.int64)
        if attenuation.ndim != 2 or weights.shape != attenuation.shape[1:] or not 0 <= starts[-1] <= len(weights):
            raise InputError(
                f"attenuation {attenuation.shape}, weights {weights.shape} and channel starts {starts.tolist()} "
                "do not match"
            )
        solids = solids.checked(len(attenuation), background)
        air = _open_beam(weights, starts, (rows, columns), profile)
        shapes = frame, solids.kinds, solids.locals_
        outline = cone_silhouettes(*shapes) if with_silhouettes else no_silhouettes(cone_bounds(*shapes))
        mesh, creases, pieces = None, None, 0
        if solids.surfaces is not None:
            seen = mesh_view(frame, rows, columns, solids.surfaces, with_outline=with_silhouettes)
            mesh, creases, pieces = seen.with_room(), seen.outline, seen.pieces
        room = np.empty(solids.rows, np.int64), event_room(solids.rows, pieces)
        ray = (*room, np.empty(len(attenuation)), np.empty(len(air)))
        if profile is not None:
            profile = np.ascontiguousarray(profile, dtype=np.float64)
            if profile.shape[1:] != (rows, columns) or not 0 < len(profile) < len(attenuation):
                raise InputError(
                    f"a profile of shape {profile.shape} does not fit {rows} x {columns} pixels and "
                    f"{len(attenuation)} materials"
                )
        maps, map_grid = None, 0
        if solids.voxels is not None:
            maps, map_grid = tuple(solids.voxels), _map_grid(frame, solids, solids.voxels, rays_per_voxel)
            # The faces of a map's box are faces of voxels like all others.
            plain = solids.voxels.numbers[outline.shapes] < 0
            outline = Silhouettes(outline.forms[plain], outline.shapes[plain], outline.roots[plain], outline.bounds)
        tiles = Tiles.of(outline.bounds, outline.shapes, rows, columns)
        arrays = (frame, solid_table(solids), ring_tubes(solids), mesh, maps, tuple(tiles), int(background), profile)
        return cls(arrays, creases, map_grid, outline, (attenuation, weights, starts, air), ray)


def _open_beam(
    weights: Float[np.ndarray, " node"],
    starts: Int64[np.ndarray, " boundary"],
    pixels: tuple[int, int],
    profile: Float[np.ndarray, "part row column"] | None,
) -> Float[np.ndarray, "channel rows columns"]:
    """Counts of a ray to each pixel that meets no object; with a profile, room that the kernel fills."""
    air = np.array([weights[a:b].sum() for a, b in pairwise(starts)])
    alike = np.broadcast_to(air[:, None, None], (len(air), *pixels))
    return alike if profile is None else alike.copy()


def _map_grid(frame: Float[np.ndarray, "4 3"], solids: Solids, maps: VoxelMaps, rays_per_voxel: float) -> int:
    """Rays per pixel and axis for voxel maps: by the widest pixel, as seen in the middle of a map, in its voxels."""
    fewest = ceil(rays_per_voxel)
    for row in np.flatnonzero(maps.numbers >= 0):
        axes = np.linalg.inv(solids.locals_[row, :, :3])
        depth = np.linalg.solve(frame[1:].T, -axes @ solids.locals_[row, :, 3] - frame[0])[0]
        voxel = (2 * np.linalg.norm(axes, axis=0) / maps.shapes[maps.numbers[row], ::-1]).min()
        pixel = abs(depth) * np.linalg.norm(frame[2:], axis=1).max()
        fewest = max(fewest, ceil(rays_per_voxel * pixel / voxel))
    return min(fewest, MOST_RAYS)
