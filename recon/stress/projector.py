"""Gaussians at the limits: line integrals and voxel means against closed forms in float64."""

from collections.abc import Iterator
from math import pi

import numpy as np
import torch
from jaxtyping import Float
from scipy.special import erf

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.stress.case import Point
from recon.ops.rasterize import FARTHEST, Projector, rasterize
from recon.ops.rasterize.reference import rotation
from recon.ops.voxelize import voxelize

_SOD, _SDD, _PITCH = 500.0, 800.0, 1.6  # mm
_PIXEL = _PITCH * _SOD / _SDD  # edge of a pixel at the isocentre [mm]
_ROWS, _COLUMNS, _VIEWS = 33, 41, 3
_POINTS = Projector(footprint=0.0, cutoff=FARTHEST)  # rays through pixel centres; 3.7e-6 of a peak is cut off
_COUNT, _SPREAD = 30, 8.0  # Gaussians of a scene, and how far from the isocentre [mm]

Parts = tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]


def needles() -> Iterator[Point]:
    """Gaussians of 0.3 pixels across, ever longer.

    Yields
    ------
    ratio of length and width
    """
    for ratio in (1, 10, 100, 1000):
        yield _compared(ratio, _scene((0.3 * ratio, 0.3, 0.3)))


def discs() -> Iterator[Point]:
    """Gaussians of 20 pixels across, ever thinner.

    Yields
    ------
    ratio of width and thickness
    """
    for ratio in (1, 10, 100, 1000):
        yield _compared(ratio, _scene((20.0, 20.0, 20 / ratio)))


def wide() -> Iterator[Point]:
    """Gaussians ever wider, up to many times the panel.

    Yields
    ------
    standard deviation [pixel]
    """
    for width in (1.0, 10.0, 30.0, 100.0, 1000.0):
        yield _compared(width, _scene((width, 0.7 * width, 0.5 * width)))


def around_the_source() -> Iterator[Point]:
    """A Gaussian ever nearer to the source, so that rays begin inside of it, and behind the source.

    Yields
    ------
    distance of the source from the centre in standard deviations; below 0 the centre lies behind the source
    """
    sigma, geometry = 20.0, _geometry(_SOD, 1)
    for distance in (10.0, 5.0, 2.0, 1.0, 0.1, 0.0, -1.0):
        centre = torch.from_numpy(geometry.ray_frames()[0, 0] * (1 - distance * sigma / _SOD))[None]
        size = torch.full((1, 3), sigma, dtype=torch.float64).log()
        turn = torch.tensor([[1.0, 0.2, 0.1, 0.3]], dtype=torch.float64)
        yield _compared(distance, (centre, size, turn, torch.ones(1, 1, dtype=torch.float64)), geometry)


def distant_source() -> Iterator[Point]:
    """A source ever farther away, as at a synchrotron.

    Yields
    ------
    distance of the source [mm]
    """
    for distance in (5e2, 1e4, 1e6, 1e8, 1e9):
        yield _compared(distance, _scene((1.0, 0.6, 2.0)), _geometry(distance, _VIEWS))


def narrow() -> Iterator[Point]:
    """A Gaussian ever narrower than a pixel: sum of pixel means against the integral of the Gaussian.

    Yields
    ------
    standard deviation [pixel]
    """
    frames = _frames(_geometry(1e9, 1))  # parallel rays: all pixels have the same area
    for width in (3.0, 1.0, 0.5, 0.2, 0.05, 1e-3):
        sigma = width * _PITCH
        parts = _ball((0.31, -0.17, 0.23), sigma)
        image = rasterize(*_single(parts), frames, _ROWS, _COLUMNS, Projector(cutoff=FARTHEST))
        found = float(image.double().sum()) * _PITCH**2
        yield _relative(width, found, (2 * pi) ** 1.5 * sigma**3)


def narrow_in_voxels() -> Iterator[Point]:
    """A Gaussian ever narrower than a voxel: sum of voxel means against the integral of the Gaussian.

    Yields
    ------
    standard deviation [voxel]
    """
    grid = Grid.cube(32, 32.0)
    for width in (3.0, 1.0, 0.5, 0.2, 0.05, 1e-3):
        parts = _ball((0.31, -0.17, 0.23), width)
        found = float(voxelize(*_single(parts), grid, cutoff=FARTHEST).sum(dtype=np.float64))
        yield _relative(width, found, (2 * pi) ** 1.5 * width**3)


def few_pixels() -> Iterator[Point]:
    """One Gaussian in one view on ever fewer pixels, odd numbers of them.

    Yields
    ------
    number of pixels
    """
    centres, log_scales, quaternions, coefficients = _scene((9.0, 4.0, 2.0))
    parts = centres[:1], log_scales[:1], quaternions[:1], coefficients[:1]
    for rows, columns in ((33, 41), (7, 5), (3, 1), (1, 3), (1, 1)):
        geometry = Geometry.circular(_SOD, _SDD, np.array([0.2]), Panel(rows, columns, _PITCH))
        yield _compared(rows * columns, parts, geometry)


def one_voxel() -> Iterator[Point]:
    """The mean of a Gaussian over the only voxel of a grid, ever flatter.

    Yields
    ------
    ratio of the edges of the voxel
    """
    centre, sigma = (3.1, -1.7, 2.3), 40.0  # mm
    for ratio in (1.0, 3.0, 10.0, 30.0):
        edges = (20.0 / ratio, 20.0, 20.0)  # z, y, x
        grid = Grid((1, 1, 1), edges, (0.0, 0.0, 0.0))
        found = float(voxelize(*_single(_ball(centre, sigma)), grid, cutoff=FARTHEST)[0, 0, 0, 0])
        means = [_mean(*axis, sigma) for axis in zip(edges, centre[::-1], strict=True)]
        yield _relative(ratio, found, float(np.prod(means)))


def _mean(edge: float, centre: float, sigma: float) -> float:
    """Mean of exp(-(x - centre)^2 / (2 sigma^2)) over an edge around 0."""
    first, last = ((end - centre) / sigma / np.sqrt(2) for end in (-edge / 2, edge / 2))
    return sigma * np.sqrt(pi / 2) * (erf(last) - erf(first)) / edge


def _compared(difficulty: float, parts: Parts, geometry: Geometry | None = None) -> Point:
    """Compare all pixels with the closed form: largest difference, in parts of the largest line integral."""
    geometry = _geometry(_SOD, _VIEWS) if geometry is None else geometry
    expected = _line_integrals(parts, geometry)
    image = rasterize(*_single(parts), _frames(geometry), geometry.panel.rows, geometry.panel.columns, _POINTS)
    found = image[:, 0].numpy().astype(float)
    worst = np.unravel_index(np.argmax(np.abs(found - expected)), found.shape)
    error = float(np.abs(found[worst] - expected[worst]) / expected.max())
    return Point(difficulty, float(found[worst]), float(expected[worst]), error)


def _relative(difficulty: float, found: float, expected: float) -> Point:
    return Point(difficulty, found, expected, abs(found / expected - 1))


def _line_integrals(parts: Parts, geometry: Geometry) -> Float[np.ndarray, "view row column"]:
    """Integrate Gaussians from the source to each pixel's centre in closed form.

    With u = A (o - p) and v = A d in units of standard deviations, the integral of exp(-|u + t v|^2 / 2) |d| over
    0 < t < 1 is |d| sqrt(pi / 2) / |v| exp(-|u x v|^2 / (2 |v|^2)) [erf((|v|^2 + u.v) / (sqrt 2 |v|)) -
    erf(u.v / (sqrt 2 |v|))].
    """
    centres, log_scales, quaternions, coefficients = parts
    whiten = (torch.exp(-log_scales)[:, :, None] * rotation(quaternions).mT).numpy()
    rows, columns = np.mgrid[: geometry.panel.rows, : geometry.panel.columns]
    images = []
    for origin, first, du, dv in geometry.ray_frames():
        d = first + columns[..., None] * du + rows[..., None] * dv
        u = np.einsum("nij,nj->ni", whiten, origin - centres.numpy())[:, None, None]
        v = np.einsum("nij,rcj->nrci", whiten, d)
        length, along = np.linalg.norm(v, axis=-1), np.sum(u * v, axis=-1)
        aside = np.linalg.norm(np.cross(np.broadcast_to(u, v.shape), v), axis=-1) / length
        ends = erf((length + along / length) / np.sqrt(2)) - erf(along / length / np.sqrt(2))
        part = np.sqrt(pi / 2) / length * np.exp(-(aside**2) / 2) * ends * np.linalg.norm(d, axis=-1)
        images.append(np.einsum("nrc,n->rc", part, coefficients[:, 0].numpy()))
    return np.stack(images)


def _scene(widths: tuple[float, float, float]) -> Parts:
    """Gaussians of the given widths [pixel at the isocentre] in random places and directions, the same in each call."""
    rng = np.random.default_rng(0)
    parts = (
        rng.uniform(-_SPREAD, _SPREAD, (_COUNT, 3)),
        np.log(np.tile(np.array(widths) * _PIXEL, (_COUNT, 1))),
        rng.normal(size=(_COUNT, 4)),
        rng.uniform(0.1, 1.0, (_COUNT, 1)),
    )
    centres, log_scales, quaternions, coefficients = (torch.from_numpy(part) for part in parts)
    return centres, log_scales, quaternions, coefficients


def _ball(centre: tuple[float, float, float], sigma: float) -> Parts:
    """One round Gaussian of height 1."""
    size = torch.full((1, 3), sigma, dtype=torch.float64).log()
    turn = torch.tensor([[1.0, 0.0, 0.0, 0.0]], dtype=torch.float64)
    return torch.tensor([centre], dtype=torch.float64), size, turn, torch.ones(1, 1, dtype=torch.float64)


def _geometry(distance: float, views: int) -> Geometry:
    """A circle of views from a source at a distance [mm] from the isocentre."""
    angles = 0.2 + np.arange(views) * 2 * pi / views
    return Geometry.circular(distance, distance + _SDD - _SOD, angles, Panel(_ROWS, _COLUMNS, _PITCH))


def _single(parts: Parts) -> Parts:
    """Convert Gaussians to single precision, as fits have them."""
    centres, log_scales, quaternions, coefficients = parts
    return centres.float(), log_scales.float(), quaternions.float(), coefficients.float()


def _frames(geometry: Geometry) -> torch.Tensor:
    return torch.from_numpy(geometry.ray_frames())
