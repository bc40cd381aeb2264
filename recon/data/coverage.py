"""What a scan covers, from its counts: whether its object leaves the panel or the grid, and a grid that would hold it.

Where an object leaves the panel or the grid, rays are attenuated by what no voxel holds. A fit then puts that into
voxels at the border, and into the wrong bases. A margin that is fitted as well and cut off again takes it instead. How
far the object goes on where no view sees it is not known; that of a round one of even density follows from how much
its rays are attenuated at the border of the panel, compared with those through its middle.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.data.measurements import Measurements
from recon.data.partial_volume import FEWEST
from recon.data.view_subsets import kinds_of, spread

VIEWS = 48  # at most, evenly spread, that are looked at
BLOCKS = 32  # along the longer side of the panel, in which counts are summed
BORDER = 2  # pixels of the panel that tell whether an object goes on beyond it
ATTENUATED = 0.05  # log projection; scatter and drift make up less
CERTAIN = 5.0  # standard deviations of its noise that it must exceed
FEW_BLOCKS = 0.05  # of a border; what is less may be a defect
FEW_RAYS = 0.005  # of those through the object
NEAR = 0.1  # rad; of an opposite view
LARGEST = 2.0  # times the field of view that an object is taken to fill, at most
SIDES = ("left", "right", "top", "bottom")


@dataclass(frozen=True)
class Coverage:
    """Of an object by a scan.

    Parameters
    ----------
    sides : parts of the views in which the object leaves the panel by each of `SIDES`
    lateral, axial : parts of the views in which it does so and no other view makes up for it
    outside : part of the rays through the object that miss the grid
    starved : part of the rays through the object that hardly anything passed, in all channels together
    views : that were looked at
    grid : the smallest grid that holds what the rays see, of the same voxels; the one asked for where it does
    """

    sides: tuple[float, ...]
    lateral: float
    axial: float
    outside: float
    starved: float
    views: int
    grid: Grid


def coverage(measured: Measurements, grid: Grid) -> Coverage:
    """What the views of a scan cover of its object.

    Parameters
    ----------
    measured : the scan, before pixels are summed
    grid : that was asked for
    """
    some = measured[spread(kinds_of(measured.exposure), VIEWS)]
    panel, size = some.geometry.panel, -(-max(some.counts.shape[2:]) // BLOCKS)
    rows, columns = (np.arange(0, n, size) for n in (panel.rows, panel.columns))
    shadow = _Shadow.of(some, rows, columns)
    sides = _leaving(some, size)
    share = sides.mean(axis=0)
    frames = some.geometry.ray_frames()
    middle = (np.append(columns[1:], panel.columns) + columns - 1) / 2, (np.append(rows[1:], panel.rows) + rows - 1) / 2
    block = float(np.median(_pixel_height(some.geometry)) * size)
    across, height, missed_beside, missed = _paths(frames, *middle, grid, block)
    seen = shadow.attenuated
    count = max(int(seen.sum()), 1)
    beside, above = ((seen & miss).sum() / count for miss in (missed_beside, missed & ~missed_beside))
    edges = border_distances(some.geometry)
    reach = float(np.median(edges.max(axis=1)))
    outer = edges >= 0.9 * edges.max(axis=1, keepdims=True)  # of a half-fan, the other side is seen from opposite
    alone = ~_met_from_opposite(some.geometry, measured.geometry)  # or should be
    lateral = float((sides[:, :2] & (outer | alone)).any(axis=1).mean())
    distance = np.linalg.norm(frames[:, 0, :2], axis=1)[:, None, None]
    radius = float(np.quantile(across[seen], 0.995)) if seen.any() else 0.0
    if (sides[:, :2] & outer).any():
        radius = max(radius, min(_beyond(shadow, sides[:, :2] & outer, across) * reach, LARGEST * reach))
    nearest = height[1][seen] if seen.any() else np.zeros(1)
    far = height[0] + (height[1] - height[0]) * (1 + radius / np.maximum(distance, radius + 1e-9))
    low_end, high_end = (float(np.quantile(nearest, q)) for q in (0.002, 0.998))
    z = grid.axis("z")
    faces = z[0] - grid.spacing[0] / 2, z[-1] + grid.spacing[0] / 2
    room = 2 * max(grid.spacing[0], block)
    leaves = bool(share[2:].any()) or above > FEW_RAYS
    ends = [faces[0], faces[1]]
    if leaves and seen.any():
        exits = np.array([low_end, high_end])
        if share[2:].any():  # it may go on to where the rays through the border leave it
            exits = np.quantile(far[seen], (0.002, 0.998)) + np.array([-block, block]) / 2
        ends[0] = min(ends[0], exits[0]) if low_end < faces[0] + room else ends[0]
        ends[1] = max(ends[1], exits[1]) if high_end > faces[1] - room else ends[1]
    hidden = height[1].max() < faces[1] - room or height[1].min() > faces[0] + room  # from all views, as of a helix
    axial = float(sides[:, 2:].any(axis=1).mean()) if hidden or ends != [faces[0], faces[1]] else 0.0
    wide = radius if lateral or beside > FEW_RAYS else 0.0
    grown = grown_to(grid, wide, (ends[0], ends[1]))
    outside = float(beside + above)
    return Coverage(
        tuple(map(float, share)),
        lateral,
        axial,
        outside if outside > FEW_RAYS else 0.0,
        float((seen & shadow.starved).sum() / count),
        len(some),
        grown,
    )


@dataclass(frozen=True, eq=False)
class _Shadow:
    """Blocks of pixels of some views: log projections of all channels together, where they are certain, and starved."""

    logs: Float[np.ndarray, "view row column"]
    attenuated: Bool[np.ndarray, "view row column"]
    starved: Bool[np.ndarray, "view row column"]

    @classmethod
    def of(cls, measured: Measurements, rows: np.ndarray, columns: np.ndarray) -> "_Shadow":
        beam = measured.gains * measured.open_beam
        parts = [
            [_sums(image, rows, columns) for image in (np.asarray(counts).sum(0), (beam * e[:, None, None]).sum(0))]
            for counts, e in zip(measured.counts, measured.exposure, strict=True)
        ]
        counts, air = (np.stack(images) for images in zip(*parts, strict=True))
        pixels = _sums((beam > 0).any(axis=0).astype(float), rows, columns)
        logs, certain = _attenuation(counts, air)
        return cls(logs, certain, counts < FEWEST * np.maximum(pixels, 1))


def _sums(image: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    return np.add.reduceat(np.add.reduceat(image.astype(np.float64), rows, axis=-2), columns, axis=-1)


def _attenuation(counts: np.ndarray, air: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Log projections, and where they are certain."""
    logs = np.log(np.where(air > 0, np.maximum(air, 0.5), 1.0)) - np.log(np.where(air > 0, np.maximum(counts, 0.5), 1))
    return logs, (air > 0) & (logs > np.maximum(ATTENUATED, CERTAIN / np.sqrt(np.maximum(counts, 0.5))))


def _leaving(measured: Measurements, size: int) -> Bool[np.ndarray, "view side"]:
    """Whether the object goes on beyond each side of the panel, by the outermost pixels."""
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


def _paths(
    frames: Float[np.ndarray, "view 4 3"], columns: np.ndarray, rows: np.ndarray, grid: Grid, spare: float = 0.0
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray], np.ndarray, np.ndarray]:
    """Of the rays through points of the panel, each (view, row, column).

    Returns
    -------
    distance from the axis of rotation [mm]; height of the source, and of the point nearest to the axis [mm]; whether
    they pass the grid beside it, and at all, by more than `spare` [mm]
    """
    source, first, step, down = (frames[:, None, None, i] for i in range(4))
    direction = first + columns[None, None, :, None] * step + rows[None, :, None, None] * down
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
    return across, (np.broadcast_to(source[..., 2], height.shape), height), beside, enter >= leave


def border_distances(geometry: Geometry) -> Float[np.ndarray, "view 2"]:
    """Distance of the rays through the middle of the left and of the right border from the axis of rotation [mm]."""
    panel = geometry.panel
    columns = np.array([-0.5, panel.columns - 0.5])
    return _paths(geometry.ray_frames(), columns, np.array([(panel.rows - 1) / 2]), Grid.cube(1, 1.0))[0][:, 0]


def _met_from_opposite(some: Geometry, every: Geometry) -> Bool[np.ndarray, "view 2"]:
    """Whether the rays of some views through the left and the right border have a view at their other end.

    That is where they leave the circle on which the source moves; a view counts that is near in azimuth, by the gaps
    that so many views leave on a circle.
    """
    source, first, step, down = (part[:, None, :2] for part in np.moveaxis(some.ray_frames(), 1, 0))
    columns = np.array([-0.5, some.panel.columns - 0.5])[None, :, None]
    direction = first + columns * step + (some.panel.rows - 1) / 2 * down
    flat = np.maximum(np.sum(direction**2, axis=-1, keepdims=True), 1e-30)
    x, y = np.moveaxis(source - 2 * np.sum(source * direction, axis=-1, keepdims=True) / flat * direction, -1, 0)
    wanted, there = np.arctan2(y, x), np.arctan2(every.source[:, 1], every.source[:, 0])
    turned = np.abs((wanted[..., None] - there + np.pi) % (2 * np.pi) - np.pi).min(axis=-1)
    return turned <= max(4 * np.pi / len(every), NEAR)


def _pixel_height(geometry: Geometry) -> Float[np.ndarray, " view"]:
    """Distance of two rows, seen at the axis [mm]."""
    panel = geometry.panel
    rows = (panel.rows - 1) / 2 + np.array([-0.5, 0.5])
    heights = _paths(geometry.ray_frames(), np.array([(panel.columns - 1) / 2]), rows, Grid.cube(1, 1.0))[1][1]
    return np.abs(np.diff(heights[:, :, 0], axis=1))[:, 0]


def _beyond(
    shadow: _Shadow, leaving: Bool[np.ndarray, "view side"], across: Float[np.ndarray, "view row column"]
) -> float:
    """Radius of the object over that of the field of view, as if it were round and even: chords are sqrt(R^2 - s^2).

    The middle of the object is the inner half of the field of view, which is beside the middle of a half-fan's panel.
    """
    found, near = [1.0], _inner_half(across)
    for side, column in enumerate((0, -1)):
        for logs, middle_half in zip(shadow.logs[leaving[:, side]], near[leaving[:, side]], strict=True):
            inside = logs[:, middle_half]
            rows = np.argsort(inside.mean(axis=1))[-max(len(logs) // 2, 1) :]  # through the object
            middle, border = float(np.median(inside[rows])), float(np.median(logs[rows, column]))
            part = np.clip(border / max(middle, 1e-6), 0, 0.99)
            found.append(1 / np.sqrt(1 - part**2))
    return float(np.quantile(found[1:], 0.5)) if len(found) > 1 else 1.0


def _inner_half(across: Float[np.ndarray, "view row column"]) -> Bool[np.ndarray, "view column"]:
    """Blocks that lie within half the distance of the outermost from the axis, at least one of each view."""
    distance = across[:, across.shape[1] // 2]
    step = np.median(np.abs(np.diff(distance, axis=1)), axis=1) if distance.shape[1] > 1 else np.zeros(len(distance))
    half = (distance.max(axis=1) + step / 2) / 2 + step / 2  # from the axis to the border, and half a block more
    return distance <= np.maximum(half * (1 - 1e-6), distance.min(axis=1))[:, None]


def grown_to(grid: Grid, radius: float, ends: tuple[float, float]) -> Grid:
    """The grid with voxels added, so that it holds a circle about the axis and reaches from one height to another."""
    wanted = (ends, (-radius, radius), (-radius, radius))
    shape, origin = [], []
    for n, spacing, first, (low, high) in zip(grid.shape, grid.spacing, grid.origin, wanted, strict=True):
        before = max(int(np.ceil((first - spacing / 2 - low) / spacing - 1e-6)), 0)
        after = max(int(np.ceil((high - (first + (n - 0.5) * spacing)) / spacing - 1e-6)), 0)
        shape.append(n + before + after)
        origin.append(first - before * spacing)
    return grid if tuple(shape) == grid.shape else Grid(tuple(shape), grid.spacing, tuple(origin))


def inner_box(grid: Grid, grown: Grid) -> tuple[slice, slice, slice]:
    """Where the voxels of a grid are in one that has grown from it."""
    firsts = [round((a - b) / s) for a, b, s in zip(grid.origin, grown.origin, grid.spacing, strict=True)]
    return tuple(slice(first, first + n) for first, n in zip(firsts, grid.shape, strict=True))  # type: ignore[return-value]
