"""What the scan can see of the scene: where points of the objects fall on the panel, and the rays through them."""

from collections.abc import Iterable, Iterator
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float

from phantomgen.geometry.panel import Panel
from phantomgen.ops.primitives import BALL, CONE, CYLINDER, HALFSPACE, TORUS
from phantomgen.ops.trace import trace
from phantomgen.scene.scan import Scan, Scene
from phantomgen.shapes import Part, Shape
from phantomgen.simulation.checks.half_turns import helix_axis, lacks_directions

_POINTS = 500
_RAYS_PER_OBJECT = 40
_SKIN = 1e-6
# Of scenes with more objects than `_MANY`, the largest ones of each material are sampled, in some of the views.
_MANY = 64
_RAYS = 20_000
# Other scenes are sampled in as many views as give no more rays than this.
_MOST_RAYS = 150_000
# Objects that are cut off are described one by one up to this number, and counted beyond it.
_DESCRIBED = 8


def coverage_warnings(scan: Scan) -> list[str]:
    """Sentences about objects that are empty, hold the source, or are cut off by panel or volume, with how much."""
    return [*_solid_warnings(scan), *_panel_warnings(scan), *_volume_warnings(scan)]


@lru_cache(maxsize=1)
def sampled_lengths(scan: Scan) -> Float[np.ndarray, "ray material"]:
    """Path lengths per material [mm] of rays through objects: all of them in all views, as far as rays are few."""
    objects, frames = scan.scene.objects, scan.geometry.ray_frames()
    many = len(objects) > _MANY
    picked = _largest(scan.scene) if many else range(len(objects))
    targets = np.concatenate([points_of(objects[i][0], _RAYS_PER_OBJECT)[0] for i in picked])
    frames = frames[:: -(-len(frames) * len(targets) // (_RAYS if many else _MOST_RAYS))]
    to_target = targets[None] - frames[:, None, 0]
    depth = on_panel(frames, targets)[..., 0]
    in_front = depth > 1e-6
    directions = to_target[in_front] / depth[in_front][:, None]
    origins = np.broadcast_to(frames[:, None, 0], to_target.shape)[in_front]
    return trace(origins, directions, scan.scene.solids, len(scan.scene.materials), scan.scene.background)


def _solid_warnings(scan: Scan) -> Iterator[str]:
    """Objects that the source runs into, and objects without a point inside."""
    sources = scan.geometry.ray_frames()[:, 0]
    for i, name, shape in named(scan, _around(scan, sources)):
        inside = shape.contains(sources).mean()
        if inside:
            yield (
                f"object {i} ({name}) contains the source in {inside:.0%} of the views, "
                f"{np.linalg.norm(sources[0]):.4g} mm from the centre: rays count its length from the source on; make "
                "it smaller, or move the source, if that is not meant"
            )
    combined = [i for i, (shape, _) in enumerate(scan.scene.objects) if shape.volume is None]
    for i, name, shape in named(scan, combined):
        if not len(points_of(shape, _POINTS)[0]):
            yield f"object {i} ({name}) is empty, or too thin to be found: no random point of its bounds lies inside it"


def named(scan: Scan, numbers: Iterable[int]) -> Iterator[tuple[int, str, Shape]]:
    """Objects with their numbers and the names of their materials."""
    for i in numbers:
        shape, material = scan.scene.objects[i]
        yield i, _name(scan, material), shape


def _around(scan: Scan, points: Float[np.ndarray, "point 3"]) -> list[int]:
    """Numbers of objects that may contain one of some points; balls around them do."""
    solids = scan.scene.solids
    near = np.zeros(len(solids.balls), np.bool_)
    for point in points:
        near |= ((solids.balls[:, :3] - point) ** 2).sum(axis=1) <= solids.balls[:, 3]
    return np.searchsorted(np.unique(solids.owners), np.unique(solids.owners[near & solids.inside])).tolist()


def _largest(scene: Scene) -> list[int]:
    """Numbers of the largest objects of each material, `_MANY` in all or one of each."""
    solids = scene.solids
    size = np.where(solids.inside & (solids.kinds != HALFSPACE), solids.balls[:, 3], 0.0)
    first_rows = np.unique(solids.owners)
    by_size = np.argsort(-np.maximum.reduceat(size, first_rows), kind="stable")
    materials = solids.materials[first_rows][by_size]
    share = max(1, _MANY // len(scene.materials))
    return [int(i) for m in range(len(scene.materials)) for i in by_size[materials == m][:share]]


def _panel_warnings(scan: Scan) -> Iterator[str]:
    """Objects that leave the panel in some view."""
    frames, panel = scan.geometry.ray_frames(), scan.geometry.panel
    suspects = reaching(scan, _panel_planes(frames, panel))
    axis = helix_axis(frames, panel)
    if axis is not None:  # which every object leaves above and below, as it should
        yield from _helix_warning(scan, suspects, frames, axis)
    described = 0
    for rank, i in enumerate(suspects):
        if described == _DESCRIBED:
            yield f"up to {len(suspects) - rank} more objects leave the panel's field of view in some view"
            return
        shape, material = scan.scene.objects[i]
        inside, surface = points_of(shape, _POINTS)
        outside, beyond = _missed(frames, surface, panel, axis is None)
        if not outside.any():
            continue
        described += 1
        share = _missed(frames, inside, panel, axis is None)[0].any(axis=0).mean()
        views = outside.any(axis=1).mean()
        yield (
            f"object {i} ({_name(scan, material)}) leaves the panel's field of view in {views:.0%} of "
            f"the views{'' if axis is None else ' sideways'}: {share:.1%} of its volume is cut off in some view, by up "
            f"to {beyond:.3g} mm on the panel"
        )


def _helix_warning(
    scan: Scan, suspects: list[int], frames: Float[np.ndarray, "view 4 3"], axis: Float[np.ndarray, " 3"]
) -> Iterator[str]:
    """One sentence where a helix sees some object from too few directions: its worst one, and how many more."""
    lacking = {}
    for i in suspects:
        points = points_of(scan.scene.objects[i][0], _POINTS)[0]
        seen = ~_missed(frames, points, scan.geometry.panel)[0]
        if len(points) and (share := lacks_directions(frames[:, 0], axis, points, seen).mean()) > 0:
            lacking[i] = share
    if lacking:
        worst = max(lacking, key=lambda i: lacking[i])
        more = "" if len(lacking) == 1 else f", and less of {len(lacking) - 1} more"
        yield (
            f"the helix sees {lacking[worst]:.1%} of object {worst} ({_name(scan, scan.scene.objects[worst][1])}) from "
            f"less than half a turn{more}: that cannot be reconstructed; a longer range or a lower pitch sees more"
        )


def _volume_warnings(scan: Scan) -> Iterator[str]:
    """Objects that reach beyond the grid of the truth."""
    grid = scan.grid
    low = np.array([grid.origin[i] - grid.spacing[i] / 2 for i in (2, 1, 0)])
    high = low + np.array([grid.shape[i] * grid.spacing[i] for i in (2, 1, 0)])
    suspects = reaching(scan, (np.concatenate([np.eye(3), -np.eye(3)])[None], np.concatenate([-low, high])[None]))
    described = 0
    for rank, i in enumerate(suspects):
        if described == _DESCRIBED:
            yield f"up to {len(suspects) - rank} more objects reach beyond the volume"
            return
        shape, material = scan.scene.objects[i]
        lowest, highest = shape.bounds
        beyond = max((low - lowest).max(), (highest - high).max())
        if beyond <= 1e-9:
            continue
        inside, surface = points_of(shape, _POINTS)
        share = ((inside < low) | (inside > high)).any(axis=1).mean()
        if not _is_whole(shape):  # bounds may then lie far outside the shape: points of its surface tell
            beyond = max((low - surface).max(), (surface - high).max())
        if beyond > 1e-9:
            described += 1
            yield (
                f"object {i} ({_name(scan, material)}) reaches {beyond:.3g} mm beyond the volume: "
                f"{share:.1%} of it has no truth there"
            )


def reaching(
    scan: Scan, planes: tuple[Float[np.ndarray, "view plane 3"], Float[np.ndarray, "view plane"]]
) -> list[int]:
    """Numbers of objects that may reach where ``normal . x + offset < 0`` for some plane; balls around them do."""
    solids = scan.scene.solids
    inside = np.flatnonzero(solids.inside & (solids.kinds != HALFSPACE))
    balls = solids.balls[inside]
    radius, reached = np.sqrt(balls[:, 3]), np.zeros(len(inside), np.bool_)
    for normals, offsets in zip(*planes, strict=True):
        level = balls[:, :3] @ normals.T + offsets
        reached |= (level < np.linalg.norm(normals, axis=1) * radius[:, None]).any(axis=1)
    first_rows = np.unique(solids.owners)
    return np.searchsorted(first_rows, np.unique(solids.owners[inside[reached]])).tolist()


def _panel_planes(
    frames: Float[np.ndarray, "view 4 3"], panel: Panel
) -> tuple[Float[np.ndarray, "view plane 3"], Float[np.ndarray, "view plane"]]:
    """Planes between which the panel sees points, by their inner normals and offsets."""
    depth, u, v = np.moveaxis(np.linalg.inv(np.moveaxis(frames[:, 1:], 1, 2)), 1, 0)
    right, bottom = panel.columns - 0.5, panel.rows - 0.5
    normals = np.stack([depth, -depth, u + 0.5 * depth, right * depth - u, v + 0.5 * depth, bottom * depth - v], axis=1)
    offsets = -np.einsum("vpi,vi->vp", normals, frames[:, 0])
    offsets[:, 1] += 1.0
    return normals, offsets


def _is_whole(shape: Shape) -> bool:
    """Whether nothing is cut off the primitives of a shape, so that its bounds are tight."""
    return all(len(term) == 1 for term in shape.terms)


def _name(scan: Scan, material: int | tuple[int, ...]) -> str:
    """What an object consists of."""
    indices = material if isinstance(material, tuple) else (material,)
    return ", ".join(scan.scene.materials[i].name for i in indices)


def _missed(
    frames: Float[np.ndarray, "view 4 3"],
    points: Float[np.ndarray, "point 3"],
    panel: Panel,
    upright: bool = True,
) -> tuple[Bool[np.ndarray, "view point"], float]:
    """Which points no pixel sees (also those behind the source), and the largest distance beyond the panel [mm].

    Without `upright`, what leaves the panel above or below counts as seen.
    """
    depth, column, row = np.moveaxis(on_panel(frames, points), -1, 0)
    beyond = np.maximum(-0.5 - column, column - (panel.columns - 0.5)) * panel.column_pitch
    if upright:
        beyond = np.maximum(beyond, np.maximum(-0.5 - row, row - (panel.rows - 0.5)) * panel.row_pitch)
    unseen = ~((depth > 0) & (depth <= 1))
    return unseen | (beyond > 1e-9), float(beyond[~unseen].max(initial=0.0))


def on_panel(
    frames: Float[np.ndarray, "view 4 3"], points: Float[np.ndarray, "point 3"]
) -> Float[np.ndarray, "view point 3"]:
    """Depth (0 at the source, 1 on the panel), column and row of points in every view."""
    inverse = np.linalg.inv(np.moveaxis(frames[:, 1:], 1, 2))
    scaled = np.einsum("vij,vpj->vpi", inverse, points[None] - frames[:, None, 0])
    depth = scaled[..., :1]
    return np.concatenate([depth, scaled[..., 1:] / np.where(depth == 0, 1.0, depth)], axis=-1)


def points_of(shape: Shape, count: int) -> tuple[Float[np.ndarray, "point 3"], Float[np.ndarray, "point 3"]]:
    """Points spread evenly inside a shape, the middle of its bounds first if inside, and points of its surface."""
    rng = np.random.default_rng(0)
    if maps := [part for term in shape.terms for part in term if part.voxels is not None]:
        found = _voxel_points(maps[0], 4 * count, rng)
        found = found[shape.contains(found)]
        return found[:count], found
    parts = [part for term in shape.terms for part in term if part.inside and part.kind != HALFSPACE]
    outer, inner = zip(*(_surface(part, -(-count // len(parts)), rng) for part in parts), strict=True)
    surface = np.concatenate(outer)[shape.contains(np.concatenate(inner))]
    low, high = shape.bounds
    unit = np.concatenate([np.full((1, 3), 0.5), rng.random((40 * count, 3))])
    points = low + unit * (high - low)
    inside = points[shape.contains(points)][: count + 1]
    return (inside, surface) if len(surface) else (inside, inside)


def _voxel_points(part: Part, count: int, rng: np.random.Generator) -> Float[np.ndarray, "point 3"]:
    """Points [mm] in voxels of a map that are not empty."""
    local = part.voxels.points(count, rng) if part.voxels is not None else np.empty((3, 0))
    return (local.T - part.local[:, 3]) @ np.linalg.inv(part.local[:, :3]).T


def _surface(
    part: Part, count: int, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "point 3"], Float[np.ndarray, "point 3"]]:
    """Points of a primitive's surface [mm], and the same a little further inside."""
    unit = rng.uniform(-1, 1, (count, 3))
    across = np.hypot(unit[:, 0], unit[:, 1])
    middle = np.zeros((count, 3))
    if part.kind == BALL:
        unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    elif part.kind == CYLINDER:
        unit /= np.maximum(across, np.abs(unit[:, 2]))[:, None]
    elif part.kind == CONE:
        unit[:, 2] = np.sqrt(np.abs(unit[:, 2]))
        unit[:, :2] *= (unit[:, 2] / across)[:, None]
        middle[:, 2] = 0.7
    elif part.kind == TORUS:
        middle[:, :2] = unit[:, :2] * ((1 - part.tube) / across)[:, None]
        turn = np.pi * unit[:, 2:]
        unit = middle * (1 + part.tube / (1 - part.tube) * np.cos(turn)) + part.tube * np.sin(turn) * [0, 0, 1]
    else:
        unit /= np.abs(unit).max(axis=1, keepdims=True)
    axes = np.linalg.inv(part.local[:, :3])
    outer, inner = ((points - part.local[:, 3]) @ axes.T for points in (unit, middle + (1 - _SKIN) * (unit - middle)))
    return outer, inner
