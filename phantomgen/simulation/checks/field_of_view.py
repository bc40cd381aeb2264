"""Field of view: where points of the objects fall on the panel, and the rays through them."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float

from phantomgen.geometry.curved_panel import on_panel
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.ops.primitives import HALFSPACE
from phantomgen.scene.scan import Scan
from phantomgen.shapes import Shape
from phantomgen.simulation.checks.half_turns import helix_axis, lacks_directions
from phantomgen.simulation.forward_model.sampled_rays import points_of

# Points of each object that are tested.
_POINTS = 500
# Objects that are cut off are described one by one up to this number, and counted beyond it.
_DESCRIBED = 8


def coverage_warnings(scan: Scan) -> list[str]:
    """Return sentences about objects that are empty, contain the source, or are cut off by panel or volume.

    A panel of one row sees a slice of an object, and a volume of one slice asks for no more: objects may reach beyond
    both along the axis.

    Parameters
    ----------
    scan : the scan to check

    Returns
    -------
    sentences, with how much is cut off
    """
    return [*_solid_warnings(scan), *_panel_warnings(scan), *_volume_warnings(scan)]


def _solid_warnings(scan: Scan) -> Iterator[str]:
    """Objects that the source runs into, and objects without a point inside."""
    sources = scan.geometry.source
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
    """Yield objects with their numbers and the names of their materials.

    Parameters
    ----------
    scan : the scan
    numbers : indices of objects

    Yields
    ------
    index, name of the material, shape
    """
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


def _panel_warnings(scan: Scan) -> Iterator[str]:
    """Objects that leave the panel in some view."""
    geometry, panel = scan.geometry, scan.geometry.panel
    flat = panel.curvature is None
    suspects = reaching(scan, _panel_planes(geometry.ray_frames(), panel)) if flat else range(len(scan.scene.objects))
    axis = helix_axis(geometry)
    sideways = axis is not None or panel.rows == 1  # every object leaves both above and below, as it should
    if axis is not None:
        yield from _helix_warning(scan, suspects, axis)
    described = 0
    for rank, i in enumerate(suspects):
        if described == _DESCRIBED:
            yield f"up to {len(suspects) - rank} more objects leave the panel's field of view in some view"
            return
        shape, material = scan.scene.objects[i]
        inside, surface = points_of(shape, _POINTS)
        outside, beyond = _missed(geometry, surface, not sideways)
        if not outside.any():
            continue
        described += 1
        share = _missed(geometry, inside, not sideways)[0].any(axis=0).mean()
        views = outside.any(axis=1).mean()
        yield (
            f"object {i} ({_name(scan, material)}) leaves the panel's field of view in {views:.0%} of "
            f"the views{' sideways' if sideways else ''}: {share:.1%} of its volume is cut off in some view, by up "
            f"to {beyond:.3g} mm on the panel"
        )


def _helix_warning(scan: Scan, suspects: Sequence[int], axis: Float[np.ndarray, " 3"]) -> Iterator[str]:
    """One sentence where a helix sees some object from too few directions: its worst one, and how many more."""
    lacking = {}
    for i in suspects:
        points = points_of(scan.scene.objects[i][0], _POINTS)[0]
        seen = ~_missed(scan.geometry, points)[0]
        if len(points) and (share := lacks_directions(scan.geometry.source, axis, points, seen).mean()) > 0:
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
    if grid.shape[0] == 1:  # a slice asks for no truth above and below it
        low[2], high[2] = -np.inf, np.inf
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
    """Return the numbers of objects that may reach where ``normal . x + offset < 0`` for some plane.

    The bounding balls of the objects are tested.

    Parameters
    ----------
    scan : the scan
    planes : normals, (view, plane, 3), and offsets [mm], (view, plane)

    Returns
    -------
    indices of objects
    """
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
    """Return whether nothing is cut off the primitives of a shape, so that its bounds are tight."""
    return all(len(term) == 1 for term in shape.terms)


def _name(scan: Scan, material: int | tuple[int, ...]) -> str:
    """Return the names of the materials of an object."""
    indices = material if isinstance(material, tuple) else (material,)
    return ", ".join(scan.scene.materials[i].name for i in indices)


def _missed(
    geometry: Geometry,
    points: Float[np.ndarray, "point 3"],
    upright: bool = True,
) -> tuple[Bool[np.ndarray, "view point"], float]:
    """Return the points that no pixel sees, and the largest distance beyond the panel [mm].

    Points behind the source count as not seen. Without `upright`, what leaves the panel above or below counts as seen.
    """
    panel = geometry.panel
    depth, column, row = np.moveaxis(on_panel(geometry, points), -1, 0)
    beyond = np.maximum(-0.5 - column, column - (panel.columns - 0.5)) * panel.column_pitch
    if upright:
        beyond = np.maximum(beyond, np.maximum(-0.5 - row, row - (panel.rows - 0.5)) * panel.row_pitch)
    unseen = ~((depth > 0) & (depth <= 1))
    return unseen | (beyond > 1e-9), float(beyond[~unseen].max(initial=0.0))
