"""One view in the form that the kernels of expected counts take: objects, energies, rules and scratch memory."""

from math import ceil
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int64, UInt8

from phantomgen.ops.expected_counts.inputs import MOST_RAYS, ExpectedCounts, Sampling, Spectrum
from phantomgen.ops.expected_counts.pixel_classes import CLASSES
from phantomgen.ops.expected_counts.rectangles import RayList, RectangleScratch
from phantomgen.ops.mesh import mesh_view
from phantomgen.ops.mesh.cpu import TracedMeshes
from phantomgen.ops.primitives import TORUS
from phantomgen.ops.silhouette.forms import Silhouettes, cone_bounds, cone_silhouettes, no_silhouettes
from phantomgen.ops.silhouette.quadrature import Room, Rules, make_room, make_rules
from phantomgen.ops.silhouette.rings import RingForms, ring_forms
from phantomgen.ops.silhouette.tiles import Tiles
from phantomgen.ops.solids import Solids
from phantomgen.ops.trace.cpu import RayScratch
from phantomgen.ops.trace.table import TracedSolids
from phantomgen.ops.voxel_maps import VoxelMaps


class Beam(NamedTuple):
    """Energies of the beam, and what of it reaches each pixel without objects.

    Parameters
    ----------
    attenuation, weights, starts : as in `Spectrum`
    air : counts of a ray that meets no object, written where there is a profile
    profile : as in `Spectrum` [mm]
    """

    attenuation: Float[np.ndarray, "material node"]
    weights: Float[np.ndarray, " node"]
    starts: Int64[np.ndarray, " boundary"]
    air: Float[np.ndarray, "channel row column"]
    profile: Float[np.ndarray, "part row column"] | None


class View(NamedTuple):
    """Objects, rays and energies of one view.

    Parameters
    ----------
    frame : source, vector from there to the centre of pixel (0, 0), column step, row step (x, y, z) [mm]
    solids : the objects, whose table gets the source as origin
    mesh : closed meshes among them; None without any
    tiles : which objects may be met in which part of the panel
    beam : energies
    """

    frame: Float[np.ndarray, "4 3"]
    solids: TracedSolids
    mesh: TracedMeshes | None
    tiles: Tiles
    beam: Beam


class Outline(NamedTuple):
    """Places on the panel where counts are not smooth.

    Parameters
    ----------
    forms, shapes, roots, bounds : as in `phantomgen.ops.silhouette.forms.Silhouettes`
    creases : whether a silhouette or a crease of a mesh passes each pixel; None without meshes
    rings : silhouettes of tori; None without any
    """

    forms: Float[np.ndarray, "form 6"]
    shapes: Int64[np.ndarray, " form"]
    roots: Float[np.ndarray, " form"]
    bounds: Float[np.ndarray, "shape 4"]
    creases: UInt8[np.ndarray, "row column"] | None
    rings: RingForms | None


class PixelRules(NamedTuple):
    """Rules for the average over a pixel, as kernels take them.

    Parameters
    ----------
    gauss : Gauss nodes of growing strength
    reach : width of the band inside a tangent where pixels are `NEAR` [width of the aperture]
    sub_rays : 0, or so many rays along each edge of a pixel where more than the centre is needed; 1 for centres only
    map_rays : rays of a pixel that meets a voxel map
    tolerance : estimated error of log counts that is left where surfaces intersect; 0 with `sub_rays`
    aperture : width and height of the sensitive part of a pixel [pixel]
    """

    gauss: Rules
    reach: float
    sub_rays: int
    map_rays: int
    tolerance: float
    aperture: tuple[float, float]


class RayCounts(NamedTuple):
    """Scratch memory for one ray and its counts.

    Parameters
    ----------
    ray : of the objects that it meets
    lengths : path length in each material [mm]
    counts : of each channel
    """

    ray: RayScratch
    lengths: Float[np.ndarray, " material"]
    counts: Float[np.ndarray, " channel"]


class ViewScratch(NamedTuple):
    """Scratch memory for one view.

    Parameters
    ----------
    one : for one ray
    room : for one pixel that silhouettes cross
    rays : to be sent next; their nodes are those of `room`
    rectangles : for one pixel where surfaces intersect
    centres : counts of the rays through the centres of pixels
    guess : first guess of each pixel's class, 0 on entry
    signatures : of the rays through the centres, 0 on entry
    """

    one: RayCounts
    room: Room
    rays: RayList
    rectangles: RectangleScratch
    centres: Float[np.ndarray, "channel row column"]
    guess: UInt8[np.ndarray, "row column"]
    signatures: Int64[np.ndarray, "row column"]


class PreparedView(NamedTuple):
    """All arguments of `phantomgen.ops.expected_counts.cpu.expected_counts_of_view`.

    Parameters
    ----------
    view : objects, rays and energies
    outline : silhouettes and creases
    rules : rules for pixels
    scratch : scratch memory
    out : written
    """

    view: View
    outline: Outline
    rules: PixelRules
    scratch: ViewScratch
    out: ExpectedCounts


def prepare_view(
    frame: Float[np.ndarray, "4 3"],
    pixels: tuple[int, int],
    solids: Solids,
    spectrum: Spectrum,
    background: int,
    sampling: Sampling,
) -> PreparedView:
    """Check and arrange the arguments of `expected_counts`.

    Parameters
    ----------
    frame : as in `phantomgen.ops.expected_counts.expected_counts` [mm]
    pixels : rows and columns of the panel
    solids, spectrum, background, sampling : as there

    Returns
    -------
    arguments of the kernel
    """
    sampling.check()
    spectrum, solids = spectrum.checked(*pixels), solids.checked(spectrum.materials, background)
    frame = np.ascontiguousarray(frame, dtype=np.float64)
    outlined, maps = sampling.sub_rays != 1, solids.voxels
    outline = _outline(frame, solids, outlined)
    mesh, creases, pieces = None, None, 0
    if solids.surfaces is not None:
        seen = mesh_view(frame, *pixels, solids.surfaces, with_outline=outlined)
        mesh, creases, pieces = seen.traced(), seen.outline, seen.pieces
    rays_per_side = 0 if maps is None else _rays_per_side(frame, solids, maps, sampling.rays_per_voxel)
    gauss = make_rules(*sampling.rules)
    rules = PixelRules(
        gauss=gauss,
        reach=float(sampling.reach) / min(sampling.aperture),  # pixels are away, and forms are measured in apertures
        sub_rays=sampling.sub_rays or 0,
        map_rays=rays_per_side * rays_per_side,
        tolerance=0.0 if sampling.sub_rays else float(sampling.intersection_tolerance),
        aperture=(float(sampling.aperture[0]), float(sampling.aperture[1])),
    )
    rings = _rings(frame, pixels, solids, outline, rules.reach) if outlined else None
    room, shape = make_room(gauss), (spectrum.channels, *pixels)
    scratch = ViewScratch(
        one=_ray_counts(solids, spectrum, pieces),
        room=room,
        rays=RayList.of(pixels[0] * pixels[1], room.nodes),
        rectangles=RectangleScratch.of(spectrum.channels),
        centres=np.empty(shape),
        guess=np.zeros(pixels, dtype=np.uint8),
        signatures=np.zeros(pixels, dtype=np.int64),
    )
    out = ExpectedCounts(np.empty(shape), np.empty(pixels, dtype=np.uint8), np.zeros(CLASSES, dtype=np.int64))
    view = _view(frame, pixels, solids, spectrum, background, mesh, outline)
    return PreparedView(view, Outline(*outline, creases, rings), rules, scratch, out)


def prepare_grid(
    frame: Float[np.ndarray, "4 3"],
    pixels: tuple[int, int],
    solids: Solids,
    spectrum: Spectrum,
    background: int,
) -> tuple[View, RayCounts]:
    """Check and arrange the arguments of `expected_counts_by_grid`.

    Parameters
    ----------
    frame : as in `phantomgen.ops.expected_counts.expected_counts` [mm]
    pixels : rows and columns of the panel
    solids, spectrum, background : as there

    Returns
    -------
    the view, and scratch memory for one ray
    """
    spectrum, solids = spectrum.checked(*pixels), solids.checked(spectrum.materials, background)
    frame = np.ascontiguousarray(frame, dtype=np.float64)
    mesh, pieces = None, 0
    if solids.surfaces is not None:
        seen = mesh_view(frame, *pixels, solids.surfaces, with_outline=False)
        mesh, pieces = seen.traced(), seen.pieces
    view = _view(frame, pixels, solids, spectrum, background, mesh, _outline(frame, solids, False))
    return view, _ray_counts(solids, spectrum, pieces)


def _outline(frame: Float[np.ndarray, "4 3"], solids: Solids, with_forms: bool) -> Silhouettes:
    """Silhouettes of the objects, but for voxel maps: the faces of a map's box are faces of voxels like all others.

    A primitive counts only where its term may be: planes that cut a shape are not sought beside it.
    """
    shapes = frame, solids.kinds, solids.locals_
    outline = cone_silhouettes(*shapes) if with_forms else no_silhouettes(cone_bounds(*shapes))
    terms, lowest = solids.term_bounds(outline.bounds), np.array([True, False, True, False])
    limit = np.where(lowest, np.maximum(outline.bounds, terms), np.minimum(outline.bounds, terms))
    outline = outline._replace(bounds=np.ascontiguousarray(limit))
    if solids.voxels is None:
        return outline
    plain = solids.voxels.numbers[outline.shapes] < 0
    return Silhouettes(outline.forms[plain], outline.shapes[plain], outline.roots[plain], outline.bounds)


def _rings(
    frame: Float[np.ndarray, "4 3"], pixels: tuple[int, int], solids: Solids, outline: Silhouettes, reach: float
) -> RingForms | None:
    """Silhouettes of the tori; None without any."""
    tori = solids.kinds == TORUS
    if not tori.any():
        return None
    return ring_forms(frame, pixels, solids.locals_[tori], solids.tubes[tori], outline.bounds[tori], reach)


def _view(
    frame: Float[np.ndarray, "4 3"],
    pixels: tuple[int, int],
    solids: Solids,
    spectrum: Spectrum,
    background: int,
    mesh: TracedMeshes | None,
    outline: Silhouettes,
) -> View:
    """Objects, rays and energies of a view."""
    attenuation, weights, starts, profile = spectrum
    beam = Beam(attenuation, weights, starts, spectrum.open_beam(*pixels), profile)
    tiles = Tiles.of(outline.bounds, outline.shapes, *pixels)
    return View(frame, TracedSolids.of(solids, background), mesh, tiles, beam)


def _ray_counts(solids: Solids, spectrum: Spectrum, pieces: int) -> RayCounts:
    """Scratch memory for one ray, at most so many pieces of which lie in meshes."""
    return RayCounts(RayScratch.of(solids.rows, pieces), np.empty(spectrum.materials), np.empty(spectrum.channels))


def _rays_per_side(frame: Float[np.ndarray, "4 3"], solids: Solids, maps: VoxelMaps, rays_per_voxel: float) -> int:
    """Rays along each edge of a pixel for voxel maps, by the widest pixel as seen in the middle of a map, in voxels."""
    fewest = ceil(rays_per_voxel)
    for row in np.flatnonzero(maps.numbers >= 0):
        axes = np.linalg.inv(solids.locals_[row, :, :3])
        depth = np.linalg.solve(frame[1:].T, -axes @ solids.locals_[row, :, 3] - frame[0])[0]
        voxel = (2 * np.linalg.norm(axes, axis=0) / maps.shapes[maps.numbers[row], ::-1]).min()
        pixel = abs(depth) * np.linalg.norm(frame[2:], axis=1).max()
        fewest = max(fewest, ceil(rays_per_voxel * pixel / voxel))
    return min(fewest, MOST_RAYS)
