"""Silhouettes of tori: pixels against many rays, and forms against the rays that meet a torus."""

import numpy as np
import pytest

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.ops.expected_counts import (
    CROSSED,
    EMPTY,
    Spectrum,
    expected_counts,
    expected_counts_by_grid,
)
from phantomgen.ops.silhouette.forms import cone_bounds
from phantomgen.ops.silhouette.rings import ring_forms
from phantomgen.ops.trace import trace
from phantomgen.shapes import Capsule, Shape, Sphere, Torus, solids_of

SPECTRUM = Spectrum(np.array([[0.02, 0.05], [0.04, 0.12]]).T.copy(), np.array([1e4, 2e4]), np.arange(3))
TORI = {
    "upright": Torus((0, 0, 0), 32.0, 8.0),
    "face on": Torus((3, 2, 1), 32.0, 8.0, (1, 0.02, 0.03)),
    "oblique": Torus((3, 2, 1), 30.0, 12.0, (1, 0.2, 0.6)),
    "thin": Torus((0, 5, 0), 35.0, 0.6, (0.3, 1, 0.8)),
    "nearly without a hole": Torus((0, 5, 0), 20.0, 19.0, (0.3, 0.2, 1)),
}
PIXELS = 48


def frame_of(angle: float) -> np.ndarray:
    return Geometry.circular(400.0, 600.0, np.array([angle]), Panel(PIXELS, PIXELS, 3.0)).ray_frames()[0]


def worst_error(objects: list[tuple[Shape, int]], frame: np.ndarray) -> tuple[float, np.ndarray, float]:
    """Largest error of log counts of a sample of pixels, classes of all pixels, and rays per pixel."""
    solids = solids_of(objects)
    found = expected_counts(frame, PIXELS, PIXELS, solids, SPECTRUM)
    pixels = np.argwhere(found.classes != EMPTY)[::9]
    brute = expected_counts_by_grid(frame, pixels, solids, SPECTRUM, n=128, lattice=True)
    error = np.abs(np.log(found.counts[:, pixels[:, 0], pixels[:, 1]].T / brute)).max()
    return float(error), found.classes, found.rays.sum() / found.classes.size


@pytest.mark.parametrize("angle", [0.0, 0.7])
@pytest.mark.parametrize("name", TORI)
def test_pixels_are_split_along_the_silhouettes_of_a_torus(name: str, angle: float) -> None:
    error, classes, rays = worst_error([(TORI[name], 0)], frame_of(angle))
    assert error < 1e-3
    assert (classes == CROSSED).any()
    assert rays < 60  # rectangles alone take some hundred


def test_tori_cross_other_shapes() -> None:
    teeth = [(Capsule((x, y, 8), 4.0, 18.0), 1) for x, y in ((32, 10), (-32, 10), (22, 33))]
    jaw = [(Torus((0, 10, 0), 32.0, 8.0), 1), (Torus((0, 10, 0), 32.0, 6.0), 0)]
    error, _, _ = worst_error([(Sphere((0, 0, 0), 60.0), 0), *jaw, *teeth], frame_of(0.4))
    assert error < 2e-3  # as capsules alone at this size of pixels


@pytest.mark.parametrize("name", TORI)
def test_forms_are_positive_where_rays_meet_the_torus(name: str) -> None:
    frame, torus = frame_of(0.3), solids_of([(TORI[name], 0)])
    bounds = cone_bounds(frame, torus.kinds, torus.locals_)
    rings = ring_forms(frame, (PIXELS, PIXELS), torus.locals_, torus.tubes, bounds, 5.0)
    starts = rings.starts
    alone = [p for p in range(PIXELS**2) if starts[p + 1] == starts[p] + 1 and not rings.creased.ravel()[p]]
    u, v = np.random.default_rng(0).uniform(-0.5, 0.5, (2, 20))
    wrong = rays = 0
    for pixel in alone:
        a, b, c, d, e, f = rings.forms[starts[pixel]]
        value = a + b * u + c * v + d * u * u + e * u * v + f * v * v
        row, column = divmod(pixel, PIXELS)
        directions = frame[1] + (column + u)[:, None] * frame[2] + (row + v)[:, None] * frame[3]
        origins = np.broadcast_to(frame[0], directions.shape)
        met = trace(origins, directions, torus, 1)[:, 0] > 0
        if met.any() and not met.all():
            wrong, rays = wrong + np.count_nonzero(met != (value > 0)), rays + len(u)
    assert rays > 0
    assert wrong <= 0.003 * rays  # those within some thousandths of a pixel of the silhouette
