"""Content of the viewer as numbers: planes of volumes, bounds of objects, path of the source."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Float32, Shaped

from phantomgen.dataset.layout import FRACTION_SCALE
from phantomgen.dataset.truth import Truth
from phantomgen.display.figures.geometry import drawn_sources
from phantomgen.geometry.poses import Geometry, distances
from phantomgen.geometry.voxel_grid import Grid
from spectra.errors import InputError

Triple = tuple[float, float, float]
Limits = tuple[Triple, Triple]

_FULL_TURN = 2 * np.pi


@dataclass(frozen=True, eq=False)
class Content:
    """Content of the viewer for one scan.

    Parameters
    ----------
    name : of the scan
    geometry : poses of all views
    grid : voxels of the truth, or of the volume to reconstruct where there is no truth
    truth : basis volumes and material fractions
    at : where the planes x, y and z cut the volumes [mm]
    """

    name: str
    geometry: Geometry
    grid: Grid
    truth: Truth | None
    at: Triple

    def __post_init__(self) -> None:
        for axis, position, low, high in zip("xyz", self.at, *limits(self.grid), strict=True):
            if not low <= position <= high:
                raise InputError(
                    f"the plane {axis} = {position:g} mm lies outside the volume, from {low:g} to {high:g} mm"
                )

    def __repr__(self) -> str:
        return f"Content({self.name}: {self.truth!r}, {self.geometry!r})"


@dataclass(frozen=True, eq=False)
class Plane:
    """Layer of voxels across an axis.

    Parameters
    ----------
    axis : that the layer is perpendicular to, ``"x"``, ``"y"`` or ``"z"``
    position : of the layer's centre [mm]
    values : the layer
    low, high : corners (x, y, z), outer edges of the voxels; equal along `axis` [mm]
    """

    axis: str
    position: float
    values: Shaped[np.ndarray, "slow fast"]
    low: Triple
    high: Triple

    def thinned(self, most: int) -> "Plane":
        """Select some voxels of the layer.

        Parameters
        ----------
        most : largest number of voxels along an edge

        Returns
        -------
        the layer with fewer voxels
        """
        picks = (((np.arange(k := min(n, most)) + 0.5) * n / k).astype(int) for n in self.values.shape)
        return replace(self, values=self.values[np.ix_(*picks)])


@dataclass(frozen=True, eq=False)
class Material:
    """Part of a volume that one material fills, cut out with one empty voxel around it.

    Parameters
    ----------
    name : of the material
    index : among the materials of the truth
    grid, fraction : voxels of the part, and how full they are, from 0 to 1
    inner : the same of all materials that lie within its bounds, None where there are none
    level : fraction on the surface that is shown
    """

    name: str
    index: int
    grid: Grid
    fraction: Float[np.ndarray, "z y x"]
    inner: Float[np.ndarray, "z y x"] | None
    level: float

    def coarsened(self, most: int) -> "Material":
        """Average the part over larger voxels; means leave the surface in its place.

        Parameters
        ----------
        most : number of voxels along the longest edge, about

        Returns
        -------
        the part in larger voxels
        """
        factor = -(-max(self.grid.shape) // most)
        if factor <= 1:
            return self
        inner = None if self.inner is None else _binned(self.inner, factor)
        fraction = _binned(self.fraction, factor)
        spacing = tuple(factor * s for s in self.grid.spacing)
        origin = tuple(o - (factor + 1) / 2 * s for o, s in zip(self.grid.origin, self.grid.spacing, strict=True))
        level = min(self.level, float(fraction.max()) / 2)
        grid = Grid(fraction.shape, spacing, origin)  # type: ignore[arg-type]
        return replace(self, grid=grid, fraction=fraction, inner=inner, level=level)


def limits(grid: Grid) -> Limits:
    """Return the smallest and largest (x, y, z) of a grid, outer edges of the voxels.

    Parameters
    ----------
    grid : the voxels

    Returns
    -------
    corners [mm]
    """
    low = [o - s / 2 for o, s in zip(grid.origin, grid.spacing, strict=True)]
    high = [a + n * s for a, n, s in zip(low, grid.shape, grid.spacing, strict=True)]
    return _triple(low[::-1]), _triple(high[::-1])


def planes(volume: Shaped[np.ndarray, "z y x"], grid: Grid, at: Triple) -> Iterator[Plane]:
    """Yield the layers of voxels that contain a point: across x, across y and across z.

    Parameters
    ----------
    volume : values, (z, y, x)
    grid : the voxels
    at : the point (x, y, z) [mm]

    Yields
    ------
    the three layers
    """
    low, high = (np.array(corner) for corner in limits(grid))
    for axis, position in zip("xyz", at, strict=True):
        array_axis, i, layer = "zyx".index(axis), "xyz".index(axis), layer_at(grid, axis, position)
        centre = float(grid.axis(axis)[layer])
        first, last = low.copy(), high.copy()
        first[i] = last[i] = centre
        yield Plane(axis, centre, np.take(volume, layer, axis=array_axis), _triple(first), _triple(last))


def layer_at(grid: Grid, axis: str, position: float) -> int:
    """Return the index of the layer across an axis that contains a position.

    Parameters
    ----------
    grid : the voxels
    axis : ``"x"``, ``"y"`` or ``"z"``
    position : along the axis [mm]

    Returns
    -------
    index; the first or last one for positions outside
    """
    i = "zyx".index(axis)
    edge = grid.origin[i] - grid.spacing[i] / 2
    return int(np.clip((position - edge) // grid.spacing[i], 0, grid.shape[i] - 1))


def materials(truth: Truth) -> list[Material]:
    """Return all materials that fill a part of the volume.

    The surface lies where a voxel is half full, or half as full as it gets where a material is thinner than a voxel.

    Parameters
    ----------
    truth : the truth

    Returns
    -------
    the materials
    """
    boxes = {i: box_of(fraction) for i, fraction in enumerate(truth.fractions) if fraction.any()}
    return [_material(truth, i, boxes) for i in boxes]


def object_limits(truth: Truth) -> Limits | None:
    """Return the smallest and largest (x, y, z) of the voxels that are not empty.

    Parameters
    ----------
    truth : the truth

    Returns
    -------
    corners [mm]; None where all voxels are empty
    """
    filled = np.logical_or.reduce(truth.fractions)
    if not filled.any():
        return None
    low, high = limits(part_of(truth.grid, box_of(filled)))
    return low, high


def round_scale(top: float) -> tuple[float, int]:
    """Choose the end of a colour bar that begins at 0 and contains `top`, and the number of its ticks.

    Parameters
    ----------
    top : largest value

    Returns
    -------
    end of the bar, and number of ticks at round values
    """
    if not top > 0:
        return 1.0, 3
    decade = 10.0 ** np.floor(np.log10(top))
    steps = [decade * digit for digit in (0.2, 0.25, 0.4, 0.5, 0.8, 1.0, 2.0, 2.5, 4.0, 5.0)]
    counts = [int(np.ceil(top / step - 1e-6)) for step in steps]
    end, count = min((step * count, count) for step, count in zip(steps, counts, strict=True) if 3 <= count <= 7)
    return float(end), count + 1


def usual_top(values: Float32[np.ndarray, "z y x"]) -> float:
    """Return the largest value, or the 99th percentile of the filled voxels where metal exceeds all else.

    Parameters
    ----------
    values : values, (z, y, x)

    Returns
    -------
    upper end of a colour scale
    """
    filled = values[values > 0]
    if not filled.size:
        return 0.0
    top, usual = float(filled.max()), float(np.percentile(filled, 99))
    return top if top <= 2 * usual else usual


def source_path(geometry: Geometry, grid: Grid | None = None) -> Float[np.ndarray, "point 3"]:
    """Compute the curve through all source points in the order of the angle, an arc for a circular orbit.

    In a parallel beam it goes where `drawn_sources` has its start, which depends on the size of the volume `grid`.
    It is closed when the gap between its ends is no larger than twice that between other views.

    Parameters
    ----------
    geometry : poses
    grid : volume in the drawing

    Returns
    -------
    points [mm]
    """
    source = drawn_sources(geometry, grid)
    if geometry.kind not in {"circular", "parallel"} or len(source) < 2:
        known = np.isfinite(geometry.angles).all()
        return source[np.argsort(geometry.angles, kind="stable")] if known else source
    angles = np.arctan2(source[:, 1], source[:, 0]) % _FULL_TURN
    order = np.argsort(angles)
    angles, source = angles[order], source[order]
    gaps = np.diff(angles, append=angles[0] + _FULL_TURN)
    start = (gaps.argmax() + 1) % len(angles)  # the arc begins behind the widest gap
    angles, source = np.unwrap(np.roll(angles, -start)), np.roll(source, -start, axis=0)
    others = np.delete(gaps, gaps.argmax())
    if gaps.max() <= 2 * others.max():
        angles, source = np.append(angles, angles[0] + _FULL_TURN), np.concatenate([source, source[:1]])
    fine = np.linspace(angles[0], angles[-1], max(int(np.rad2deg(angles[-1] - angles[0])) + 1, 2))
    radius, height = (np.interp(fine, angles, values) for values in (np.hypot(*source[:, :2].T), source[:, 2]))
    return np.stack([radius * np.cos(fine), radius * np.sin(fine), height], axis=1)


def scan_title(geometry: Geometry) -> str:
    """Return a line of text about the scan.

    Parameters
    ----------
    geometry : poses

    Returns
    -------
    the line
    """
    found = distances(geometry)
    if found["sod_mm"] is None:
        return f"{geometry.kind} scan, {len(geometry)} views, {found['object_to_panel_mm']:.4g} mm from axis to panel"
    return f"{geometry.kind} scan, {len(geometry)} views, SOD {found['sod_mm']:.4g} mm, SDD {found['sdd_mm']:.4g} mm"


Box = tuple[tuple[int, int], tuple[int, int], tuple[int, int]]


def box_of(filled: Shaped[np.ndarray, "z y x"]) -> Box:
    """Return the first index and the index after the last one of the values that are not zero, along z, y and x.

    Parameters
    ----------
    filled : values, (z, y, x)

    Returns
    -------
    the box
    """
    ends = []
    for axis in range(3):
        found = np.flatnonzero(filled.any(axis=tuple({0, 1, 2} - {axis})))
        ends.append((int(found[0]), int(found[-1]) + 1))
    return ends[0], ends[1], ends[2]


def part_of(grid: Grid, box: Box) -> Grid:
    """Return the voxels of a box.

    Parameters
    ----------
    grid : the voxels
    box : first index and index after the last one along each axis

    Returns
    -------
    the part of the grid
    """
    shape = tuple(last - first for first, last in box)
    origin = tuple(o + first * s for o, (first, _), s in zip(grid.origin, box, grid.spacing, strict=True))
    return Grid(shape, grid.spacing, origin)  # type: ignore[arg-type]


def _material(truth: Truth, index: int, boxes: dict[int, Box]) -> Material:
    """One material in its box."""
    box = boxes[index]
    within = [i for i, other in boxes.items() if i != index and lies_within(other, box) and other != box]
    fraction = _cut(truth, index, box)
    return Material(
        name=truth.material_names[index],
        index=index,
        grid=part_of(truth.grid, tuple((first - 1, last + 1) for first, last in box)),  # type: ignore[arg-type]
        fraction=fraction,
        inner=sum((_cut(truth, i, box) for i in within), np.zeros_like(fraction)) if within else None,
        level=0.5 if fraction.max() > 0.5 else float(fraction.max()) / 2,
    )


def _cut(truth: Truth, index: int, box: Box) -> Float[np.ndarray, "z y x"]:
    """Return the fraction of one material in a box, with one empty voxel around it."""
    inside = tuple(slice(first, last) for first, last in box)
    return np.pad(truth.fractions[index][inside].astype(np.float32) / FRACTION_SCALE, 1)


def _binned(volume: Float[np.ndarray, "z y x"], factor: int) -> Float[np.ndarray, "large_z large_y large_x"]:
    """Means over cubes of voxels; the first cube lies before the volume, so that those around it are empty."""
    padded = np.pad(volume, [(factor, 2 * factor - n % factor) for n in volume.shape])
    z, y, x = (n // factor for n in padded.shape)
    return padded.reshape(z, factor, y, factor, x, factor).mean(axis=(1, 3, 5))


def lies_within(inner: Box, outer: Box) -> bool:
    """Return whether a box lies in another one.

    Parameters
    ----------
    inner, outer : boxes

    Returns
    -------
    True where it does
    """
    return all(b[0] <= a[0] and a[1] <= b[1] for a, b in zip(inner, outer, strict=True))


def _triple(values: Float[np.ndarray, " 3"] | list[float]) -> Triple:
    x, y, z = (float(value) for value in values)
    return x, y, z
