"""Rays through objects of a scan, and how long their paths are."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.curved_panel import on_panel
from phantomgen.ops.primitives import BALL, CONE, CYLINDER, HALFSPACE, TORUS
from phantomgen.scene.scan import Scan
from phantomgen.scene.scene_objects import SceneObjects
from phantomgen.shapes import Part, Shape

# Points of each object that sampled rays pass through.
_RAYS_PER_OBJECT = 40
# Depths below a surface, in half axes of the primitive, at which it is tested whether a point belongs to the surface;
# the next one where a shell is thinner than the one before.
_SKINS = (1e-6, 1e-9, 1e-12)
# Of scenes with more objects than `_MANY`, the largest ones of each material are sampled, in some of the views.
_MANY = 64
_RAYS = 20_000
# Other scenes are sampled in as many views as give no more rays than this.
_MOST_RAYS = 150_000
# Of scenes that change in time, so many views are sampled.
_INSTANTS = 24


@lru_cache(maxsize=1)
def sampled_lengths(scan: Scan) -> Float[np.ndarray, "ray material"]:
    """Compute path lengths per material of rays through objects.

    They are rays through all objects in all views, as long as these are few.

    Parameters
    ----------
    scan : what is simulated

    Returns
    -------
    path lengths [mm], (ray, material)
    """
    if scan.dynamics is not None:
        views = np.unique(np.linspace(0, len(scan.geometry) - 1, _INSTANTS).round().astype(int))
        return np.concatenate([_lengths(replace(scan.instant(v), geometry=scan.geometry[[v]])) for v in views.tolist()])
    return _lengths(scan)


def _lengths(scan: Scan) -> Float[np.ndarray, "ray material"]:
    """Path lengths of rays through objects that rest [mm]."""
    objects, geometry = scan.scene.objects, scan.geometry
    many = len(objects) > _MANY
    picked = _largest(scan.scene) if many else range(len(objects))
    targets = np.concatenate([points_of(objects[i][0], _RAYS_PER_OBJECT)[0] for i in picked])
    geometry = geometry[:: max(1, -(-len(geometry) * len(targets) // (_RAYS if many else _MOST_RAYS)))]
    to_target = targets[None] - geometry.source[:, None]
    depth = on_panel(geometry, targets)[..., 0]
    in_front = depth > 1e-6
    directions = to_target[in_front] / depth[in_front][:, None]
    origins = np.broadcast_to(geometry.source[:, None], to_target.shape)[in_front]
    return scan.scene.path_lengths(origins, directions)


def _largest(scene: SceneObjects) -> list[int]:
    """Numbers of the largest objects of each material, `_MANY` in all or one of each."""
    solids = scene.solids
    size = np.where(solids.inside & (solids.kinds != HALFSPACE), solids.balls[:, 3], 0.0)
    first_rows = np.unique(solids.owners)
    by_size = np.argsort(-np.maximum.reduceat(size, first_rows), kind="stable")
    materials = solids.materials[first_rows][by_size]
    share = max(1, _MANY // len(scene.materials))
    return [int(i) for m in range(len(scene.materials)) for i in by_size[materials == m][:share]]


def points_of(shape: Shape, count: int) -> tuple[Float[np.ndarray, "point 3"], Float[np.ndarray, "surface 3"]]:
    """Sample points evenly inside a shape, and points of its surface.

    The middle of the bounds comes first if it is inside. Where no sample hits a thin shell, points below its surface
    stand for those inside.

    Parameters
    ----------
    shape : the shape
    count : number of points

    Returns
    -------
    points inside and points of the surface [mm]
    """
    rng = np.random.default_rng(0)
    if maps := [part for term in shape.terms for part in term if part.voxels is not None]:
        found = _voxel_points(maps[0], 4 * count, rng)
        found = found[shape.contains(found)]
        return found[:count], found
    parts = [part for term in shape.terms for part in term if part.inside and part.kind != HALFSPACE]
    for skin in _SKINS:
        pairs = [_surface(part, -(-count // len(parts)), skin, rng) for part in parts]
        outer, below = (np.concatenate(points) for points in zip(*pairs, strict=True))
        found = shape.contains(below)
        surface, below = outer[found], below[found]
        if len(surface):
            break
    low, high = shape.bounds
    unit = np.concatenate([np.full((1, 3), 0.5), rng.random((40 * count, 3))])
    points = low + unit * (high - low)
    inside = points[shape.contains(points)][: count + 1]
    inside = inside if len(inside) else below
    return (inside, surface) if len(surface) else (inside, inside)


def _voxel_points(part: Part, count: int, rng: np.random.Generator) -> Float[np.ndarray, "point 3"]:
    """Points [mm] in voxels of a map that are not empty."""
    local = part.voxels.points(count, rng) if part.voxels is not None else np.empty((3, 0))
    return (local.T - part.local[:, 3]) @ np.linalg.inv(part.local[:, :3]).T


def _surface(
    part: Part, count: int, skin: float, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "point 3"], Float[np.ndarray, "point 3"]]:
    """Points of a primitive's surface [mm], and the same further inside by `skin` half axes."""
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
    outer, inner = ((points - part.local[:, 3]) @ axes.T for points in (unit, middle + (1 - skin) * (unit - middle)))
    return outer, inner
