"""Coverage of an object by a scan, from its counts: truncation by panel or grid, and a grid that is large enough.

Where an object extends beyond the panel or the grid, rays are attenuated by matter that no voxel holds. A fit then puts
that attenuation into voxels at the border, and into the wrong bases. A margin of further voxels, fitted as well and cut
off afterwards, takes it instead. The extent of the object where no view sees it is unknown; it is computed as if the
object were round and homogeneous, from the attenuation of its rays at the border of the panel relative to those through
its middle.
"""

from dataclasses import dataclass
from math import sqrt
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from phantomgen.geometry.curved_panel import ray_directions, sees
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.data.measurements import Measurements
from recon.data.partial_volume import FEWEST, LEAST_COUNTS
from recon.data.view_subsets import evenly_spread_views, view_groups

# All limits below were chosen by hand and not measured one by one; what they do together is measured by
# `python -m benchmarks.reconstruction.truncation` (docs/reference/benchmarks/truncation.md).
VIEWS = 48  # views, evenly spread; the largest number that is examined
BLOCKS = 32  # blocks along the longer side of the panel, in which counts are summed
BORDER = 2  # pixels at each border of the panel, which show whether the object extends beyond it
ATTENUATED = 0.05  # log projection; rays with more pass through the object; scatter and drift make up less
CERTAIN = 5.0  # standard deviations of the noise that a log projection must exceed as well
FEW_BLOCKS = 0.05  # of the blocks of a border; fewer attenuated ones may be defects
FEW_RAYS = 0.005  # of the rays through the object; fewer may miss the grid
OUTER = 0.9  # of the larger of both border distances of a view; a border at less is the near side of a half-fan
WIDEST_RAY = 0.995  # quantile of the distances of attenuated rays from the axis that is the radius of the object
ENDS = (0.002, 0.998)  # quantiles of the heights of attenuated rays that are the ends of the object along z
NEAR = 0.1  # rad; least difference in azimuth at which a view counts as opposite
LARGEST = 2.0  # times the field of view; largest radius that is assumed for an object
NEIGHBOURS = 1.5  # times the angle to the nearest view; directions that are closer to those seen by a view are seen
_FINEST = 0.05  # rad; angle below which directions are not told apart
_DIRECTIONS, _MOST_RAYS = 2000, 1000  # of interfaces that are examined; views
_BLOCK = 2  # voxels along each side of a block that is seen whole or not at all
SIDES = ("left", "right", "top", "bottom")


@dataclass(frozen=True)
class Coverage:
    """Coverage of an object by a scan.

    Parameters
    ----------
    sides : parts of the views in which the object extends beyond the panel at each of `SIDES`
    lateral, axial : parts of the views in which it does so and no other view covers what is missing
    outside : part of the rays through the object that miss the grid
    starved : part of the rays through the object with hardly any counts in all channels together
    views : number of views that were examined
    grid : the smallest grid that holds the object, with the same voxels; the requested grid where that holds it
    unseen : part of the directions that an interface can face which no view sees, see `unseen_directions`
    """

    sides: tuple[float, ...]
    lateral: float
    axial: float
    outside: float
    starved: float
    views: int
    grid: Grid
    unseen: float = 0.0

    @property
    def truncated(self) -> bool:
        """True where the object extends beyond the panel."""
        return bool(self.lateral or self.axial)


def coverage(measured: Measurements, grid: Grid) -> Coverage:
    """Find out how far the views of a scan cover its object.

    Parameters
    ----------
    measured : the scan, before pixels are summed
    grid : the requested grid

    Returns
    -------
    the coverage, with a grid that is large enough
    """
    some = measured[evenly_spread_views(view_groups(measured.exposure), VIEWS)]
    panel, size = some.geometry.panel, -(-max(some.counts.shape[2:]) // BLOCKS)
    rows, columns = (np.arange(0, n, size) for n in (panel.rows, panel.columns))
    blocks = _BlockProjections.of(some, rows, columns)
    sides = _leaving(some, size)
    middle = (np.append(columns[1:], panel.columns) + columns - 1) / 2, (np.append(rows[1:], panel.rows) + rows - 1) / 2
    block = float(np.median(_pixel_height(some.geometry)) * size)
    paths = _paths(some.geometry, *middle, grid, block)
    seen = blocks.attenuated
    count = max(int(seen.sum()), 1)
    beside, above = ((seen & miss).sum() / count for miss in (paths.beside, paths.missed & ~paths.beside))
    lateral, radius = _lateral_extent(some.geometry, measured.geometry, blocks, paths, sides)
    axial, ends = _axial_extent(grid, block, paths, seen, sides, radius, bool(above > FEW_RAYS))
    outside = float(beside + above)
    return Coverage(
        tuple(map(float, sides.mean(axis=0))),
        lateral,
        axial,
        outside if outside > FEW_RAYS else 0.0,
        float((seen & blocks.starved).sum() / count),
        len(some),
        grown_to(grid, radius if lateral or beside > FEW_RAYS else 0.0, ends),
        unseen_directions(measured.geometry, grid),
    )


def unseen_directions(geometry: Geometry, grid: Grid) -> float:
    """Find the part of all directions which interfaces in the middle of a grid can face without being seen by a view.

    An interface is seen by rays along it, so that a view sees the directions at right angles to its ray (Tuy 1983,
    SIAM J. Appl. Math. 43, 546-552). Directions between two views that are neighbours count as seen.

    Parameters
    ----------
    geometry : poses of the views
    grid : the voxels

    Returns
    -------
    part of the directions, 0 for a circle around the object or a helix
    """
    middle = np.array([grid.axis(name)[[0, -1]].mean() for name in "xyz"])
    rays = geometry.source[:: -(-len(geometry) // _MOST_RAYS)] - middle
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    if len(rays) < 2:
        return 1.0
    cosines = rays @ rays.T
    np.fill_diagonal(cosines, -1.0)
    between = max(NEIGHBOURS * float(np.median(np.arccos(np.clip(cosines.max(axis=1), -1.0, 1.0)))), _FINEST)
    number = np.arange(_DIRECTIONS) + 0.5
    height, turn = number / _DIRECTIONS, np.pi * (1 + sqrt(5)) * number  # a spiral over half a sphere, evenly dense
    around = np.sqrt(1 - height**2)
    facing = np.stack([around * np.cos(turn), around * np.sin(turn), height], axis=1)
    nearest = np.arcsin(np.clip(np.abs(facing @ rays.T).min(axis=1), 0.0, 1.0))
    return float((nearest > between).mean())


def seen_by_all_views(geometry: Geometry, grid: Grid) -> Bool[np.ndarray, "z y x"]:
    """Find the voxels that all views have on their panel, by blocks of voxels whose corners they see.

    Parameters
    ----------
    geometry : poses of the views
    grid : the voxels

    Returns
    -------
    mask
    """
    cuts = [np.unique([*range(0, n, _BLOCK), n]) for n in grid.shape]
    ends = [o + s * (c - 0.5) for o, s, c in zip(grid.origin, grid.spacing, cuts, strict=True)]
    places = np.stack(np.meshgrid(*ends, indexing="ij"), axis=-1)[..., ::-1].reshape(-1, 3)
    corners = np.ones(len(places), dtype=bool)
    for view in range(len(geometry)):
        corners[corners] = sees(geometry[[view]], places[corners])[0]
    seen = corners.reshape([len(c) for c in cuts])
    for axis, cut in enumerate(cuts):
        near, far = (np.take(seen, range(a, a + len(cut) - 1), axis=axis) for a in (0, 1))
        seen = np.repeat(near & far, np.diff(cut), axis=axis)
    return seen


@dataclass(frozen=True, eq=False)
class _BlockProjections:
    """Log projections of all channels together in blocks of pixels; where they are certain; where counts are few."""

    logs: Float[np.ndarray, "view row column"]
    attenuated: Bool[np.ndarray, "view row column"]
    starved: Bool[np.ndarray, "view row column"]

    @classmethod
    def of(cls, measured: Measurements, rows: np.ndarray, columns: np.ndarray) -> "_BlockProjections":
        beam = measured.gains * measured.open_beam
        parts = [
            [_sums(image, rows, columns) for image in (np.asarray(counts).sum(0), (beam * e[:, None, None]).sum(0))]
            for counts, e in zip(measured.counts, measured.exposure, strict=True)
        ]
        counts, air = (np.stack(images) for images in zip(*parts, strict=True))
        pixels = _sums((beam > 0).any(axis=0).astype(float), rows, columns)
        logs, certain = _attenuation(counts, air)
        return cls(logs, certain, counts < FEWEST * np.maximum(pixels, 1))


class _RayPaths(NamedTuple):
    """Paths of rays.

    Distance from the axis of rotation [mm]; distance of the source from the axis [mm]; height of the source, and of the
    point of the ray nearest to the axis [mm]; whether the ray passes beside the grid, and whether it misses the grid.
    """

    across: Float[np.ndarray, "view row column"]
    source_distance: Float[np.ndarray, "view 1 1"]
    source_height: Float[np.ndarray, "view row column"]
    height: Float[np.ndarray, "view row column"]
    beside: Bool[np.ndarray, "view row column"]
    missed: Bool[np.ndarray, "view row column"]


def _lateral_extent(
    some: Geometry, every: Geometry, blocks: _BlockProjections, paths: _RayPaths, sides: Bool[np.ndarray, "view side"]
) -> tuple[float, float]:
    """Part of the views that are truncated to the left or right, and the radius of the object [mm]."""
    seen, edges = blocks.attenuated, border_distances(some)
    reach = float(np.median(edges.max(axis=1)))
    outer = edges >= OUTER * edges.max(axis=1, keepdims=True)  # the inner side of a half-fan is covered from opposite
    alone = ~_met_from_opposite(some, every)  # or is not, where there is no opposite view
    lateral = float((sides[:, :2] & (outer | alone)).any(axis=1).mean())
    radius = float(np.quantile(paths.across[seen], WIDEST_RAY)) if seen.any() else 0.0
    if (sides[:, :2] & outer).any():
        beyond = _beyond(blocks, sides[:, :2] & outer, paths.across) * reach
        radius = max(radius, min(beyond, LARGEST * reach))
    return lateral, radius


def _axial_extent(
    grid: Grid,
    block: float,
    paths: _RayPaths,
    seen: Bool[np.ndarray, "view row column"],
    sides: Bool[np.ndarray, "view side"],
    radius: float,
    rays_above: bool,
) -> tuple[float, tuple[float, float]]:
    """Part of the views that are truncated above or below, and the heights between which the grid must reach [mm]."""
    nearest = paths.height[seen] if seen.any() else np.zeros(1)
    slope = 1 + radius / np.maximum(paths.source_distance, radius + 1e-9)
    far = paths.source_height + (paths.height - paths.source_height) * slope
    low_end, high_end = (float(np.quantile(nearest, q)) for q in ENDS)
    z = grid.axis("z")
    faces = z[0] - grid.spacing[0] / 2, z[-1] + grid.spacing[0] / 2
    room = 2 * max(grid.spacing[0], block)
    truncated = bool(sides[:, 2:].any())
    ends = [faces[0], faces[1]]
    if (truncated or rays_above) and seen.any():
        exits = np.array([low_end, high_end])
        if truncated:  # the object may extend to where the rays through the border leave it
            exits = np.quantile(far[seen], ENDS) + np.array([-block, block]) / 2
        ends[0] = min(ends[0], exits[0]) if low_end < faces[0] + room else ends[0]
        ends[1] = max(ends[1], exits[1]) if high_end > faces[1] - room else ends[1]
    # ends of the grid that no view sees, unlike those of a helix
    hidden = paths.height.max() < faces[1] - room or paths.height.min() > faces[0] + room
    axial = float(sides[:, 2:].any(axis=1).mean()) if hidden or ends != [faces[0], faces[1]] else 0.0
    return axial, (ends[0], ends[1])


def _sums(image: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Sums over blocks of pixels that begin at these rows and columns."""
    return np.add.reduceat(np.add.reduceat(image.astype(np.float64), rows, axis=-2), columns, axis=-1)


def _attenuation(counts: np.ndarray, air: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Log projections, and where they certainly show attenuation."""
    seen, fewest = air > 0, np.maximum(counts, LEAST_COUNTS)
    logs = np.log(np.where(seen, np.maximum(air, LEAST_COUNTS), 1.0)) - np.log(np.where(seen, fewest, 1))
    return logs, seen & (logs > np.maximum(ATTENUATED, CERTAIN / np.sqrt(fewest)))


def _leaving(measured: Measurements, size: int) -> Bool[np.ndarray, "view side"]:
    """Whether the object extends beyond each side of the panel, by the outermost pixels."""
    panel, beam = measured.geometry.panel, measured.gains * measured.open_beam
    strips = (np.s_[:, :, :BORDER], np.s_[:, :, -BORDER:], np.s_[:, :BORDER], np.s_[:, -BORDER:])
    found = np.zeros((len(measured), 4), bool)
    for side, strip in enumerate(strips):
        along = 1 if side < 2 else 2
        if (panel.columns, panel.rows)[along - 1] <= 2 * BORDER:
            continue
        places = np.arange(0, (panel.rows, panel.columns)[along - 1], size)
        for view, (counts, exposure) in enumerate(zip(measured.counts, measured.exposure, strict=True)):
            images = (
                np.asarray(counts)[strip].sum(axis=(0, 3 - along)),
                (beam[strip] * exposure[:, None, None]).sum(axis=(0, 3 - along)),
            )
            sums, air = (np.add.reduceat(image.astype(np.float64), places) for image in images)
            found[view, side] = _attenuation(sums, air)[1].sum() > max(FEW_BLOCKS * len(places), 1)
    return found


def _paths(geometry: Geometry, columns: np.ndarray, rows: np.ndarray, grid: Grid, spare: float = 0.0) -> _RayPaths:
    """Paths of the rays through points of the panel; rays miss the grid if they pass it by more than `spare` [mm]."""
    source, direction = geometry.source[:, None, None], ray_directions(geometry, columns, rows)
    flat = np.maximum(np.sum(direction[..., :2] ** 2, axis=-1), 1e-30)
    across = np.abs(source[..., 0] * direction[..., 1] - source[..., 1] * direction[..., 0]) / np.sqrt(flat)
    nearest = -np.sum(source[..., :2] * direction[..., :2], axis=-1) / flat
    height = source[..., 2] + nearest * direction[..., 2]
    enter, leave = np.full(across.shape, -np.inf), np.full(across.shape, np.inf)
    beside = np.zeros(across.shape, bool)
    for axis, name in enumerate("xyz"):
        centres, spacing = grid.axis(name), grid.spacing["zyx".index(name)]
        ends = centres[0] - spacing / 2 - spare, centres[-1] + spacing / 2 + spare
        along = np.where(np.abs(direction[..., axis]) < 1e-12, 1e-12, direction[..., axis])
        a, b = ((end - source[..., axis]) / along for end in ends)
        enter, leave = np.maximum(enter, np.minimum(a, b)), np.minimum(leave, np.maximum(a, b))
        if name == "y":
            beside = enter >= leave
    distance = np.linalg.norm(geometry.source[:, :2], axis=1)[:, None, None]
    return _RayPaths(across, distance, np.broadcast_to(source[..., 2], height.shape), height, beside, enter >= leave)


def border_distances(geometry: Geometry) -> Float[np.ndarray, "view 2"]:
    """Compute how far from the axis of rotation the rays through the left and the right border of the panel pass.

    Parameters
    ----------
    geometry : poses of the views

    Returns
    -------
    distances of the rays through the middle of the left and of the right border [mm]
    """
    panel = geometry.panel
    columns = np.array([-0.5, panel.columns - 0.5])
    return _paths(geometry, columns, np.array([(panel.rows - 1) / 2]), Grid.cube(1, 1.0)).across[:, 0]


def _met_from_opposite(some: Geometry, every: Geometry) -> Bool[np.ndarray, "view 2"]:
    """Whether the rays of some views through the left and the right border are measured from their other end, too.

    The other end is where a ray leaves the circle on which the source moves. A view nearby in azimuth suffices, by the
    gaps that so many views leave on a circle.
    """
    columns, row = np.array([-0.5, some.panel.columns - 0.5]), np.array([(some.panel.rows - 1) / 2])
    source, direction = some.source[:, None, :2], ray_directions(some, columns, row)[:, 0, :, :2]
    flat = np.maximum(np.sum(direction**2, axis=-1, keepdims=True), 1e-30)
    x, y = np.moveaxis(source - 2 * np.sum(source * direction, axis=-1, keepdims=True) / flat * direction, -1, 0)
    wanted, there = np.arctan2(y, x), np.arctan2(every.source[:, 1], every.source[:, 0])
    turned = np.abs((wanted[..., None] - there + np.pi) % (2 * np.pi) - np.pi).min(axis=-1)
    return turned <= max(4 * np.pi / len(every), NEAR)


def _pixel_height(geometry: Geometry) -> Float[np.ndarray, " view"]:
    """Distance of two rows of the panel as seen at the axis [mm]."""
    panel = geometry.panel
    rows = (panel.rows - 1) / 2 + np.array([-0.5, 0.5])
    heights = _paths(geometry, np.array([(panel.columns - 1) / 2]), rows, Grid.cube(1, 1.0)).height
    return np.abs(np.diff(heights[:, :, 0], axis=1))[:, 0]


def _beyond(
    blocks: _BlockProjections, leaving: Bool[np.ndarray, "view side"], across: Float[np.ndarray, "view row column"]
) -> float:
    """Radius of the object over that of the field of view, as if round and homogeneous: chords are 2 sqrt(R^2 - s^2).

    The middle of the object is the inner half of the field of view, which is not the middle of the panel of a half-fan.
    """
    found, near = [1.0], _inner_half(across)
    for side, column in enumerate((0, -1)):
        for logs, middle_half in zip(blocks.logs[leaving[:, side]], near[leaving[:, side]], strict=True):
            inside = logs[:, middle_half]
            rows = np.argsort(inside.mean(axis=1))[-max(len(logs) // 2, 1) :]  # through the object
            middle, border = float(np.median(inside[rows])), float(np.median(logs[rows, column]))
            part = np.clip(border / max(middle, 1e-6), 0, 0.99)
            found.append(1 / np.sqrt(1 - part**2))
    return float(np.quantile(found[1:], 0.5)) if len(found) > 1 else 1.0


def _inner_half(across: Float[np.ndarray, "view row column"]) -> Bool[np.ndarray, "view column"]:
    """Blocks within half the distance of the outermost one from the axis, at least one of each view."""
    distance = across[:, across.shape[1] // 2]
    step = np.median(np.abs(np.diff(distance, axis=1)), axis=1) if distance.shape[1] > 1 else np.zeros(len(distance))
    half = (distance.max(axis=1) + step / 2) / 2 + step / 2  # from the axis to the border, and half a block more
    return distance <= np.maximum(half * (1 - 1e-6), distance.min(axis=1))[:, None]


def grown_to(grid: Grid, radius: float, ends: tuple[float, float]) -> Grid:
    """Add voxels to a grid, so that it holds a circle about the axis and reaches from one height to another.

    Parameters
    ----------
    grid : the grid to enlarge
    radius : radius of the circle [mm]
    ends : lowest and highest height [mm]

    Returns
    -------
    the larger grid with the same voxels; `grid` itself where it is large enough
    """
    wanted = (ends, (-radius, radius), (-radius, radius))
    shape, origin = [], []
    for n, spacing, first, (low, high) in zip(grid.shape, grid.spacing, grid.origin, wanted, strict=True):
        before = max(int(np.ceil((first - spacing / 2 - low) / spacing - 1e-6)), 0)
        after = max(int(np.ceil((high - (first + (n - 0.5) * spacing)) / spacing - 1e-6)), 0)
        shape.append(n + before + after)
        origin.append(first - before * spacing)
    return grid if tuple(shape) == grid.shape else Grid(tuple(shape), grid.spacing, tuple(origin))


def inner_box(grid: Grid, grown: Grid) -> tuple[slice, slice, slice]:
    """Locate a grid in a larger one that was made from it.

    Parameters
    ----------
    grid : the original grid
    grown : the larger grid, see `grown_to`

    Returns
    -------
    ranges of voxels along z, y, x
    """
    firsts = [round((a - b) / s) for a, b, s in zip(grid.origin, grown.origin, grid.spacing, strict=True)]
    return tuple(slice(first, first + n) for first, n in zip(firsts, grid.shape, strict=True))  # type: ignore[return-value]
