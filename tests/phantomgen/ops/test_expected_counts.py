"""Pixel averages: against many rays, the definition, exact quadrature, and counts of what was traced."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.ops.expected_counts import (
    CROSSED,
    EMPTY,
    NEAR,
    SMOOTH,
    Sampling,
    Spectrum,
    expected_counts,
    expected_counts_by_grid,
)
from phantomgen.ops.expected_counts.reference import expected_counts_of_pixel
from phantomgen.ops.silhouette.forms import cone_silhouettes, parallel_silhouettes
from phantomgen.ops.silhouette.quadrature import CONICS, make_room, make_rules, square_nodes
from phantomgen.ops.silhouette.tiles import TILE, Tiles
from phantomgen.ops.trace import trace
from phantomgen.ops.trace.reference import trace_one
from phantomgen.shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Shape, Sphere, Tube, Union, solids_of
from spectra.errors import InputError
from spectra.threads import run_parallel, set_threads

NESTED: list[tuple[Shape, int]] = [
    (Cylinder((0, 0, 0), 50.0, 100.0), 0),
    (Cylinder((-22, 6, 0), 13.0, 80.0), 1),
    (Cylinder((22, -6, 0), 11.0, 80.0), 2),
    (Cylinder((0, -28, 0), 9.0, 80.0), 3),
]
# (channel, material): about the kedge preset at 33, 54, 72 and 110 keV, in 1/mm; one node per channel
ATTENUATION = np.array(
    [
        [0.033, 0.023, 0.020, 0.017],
        [0.198, 0.070, 0.048, 0.033],
        [0.082, 0.033, 0.047, 0.023],
        [0.057, 0.027, 0.032, 0.02],
    ]
)
WEIGHTS = np.array([1e4, 2e4, 3e4, 4e4])
STARTS = np.arange(5)
SPECTRUM = Spectrum(ATTENUATION, WEIGHTS, STARTS)


def frame_of(pixels: int, pitch: float, angle: float = 0.3) -> np.ndarray:
    return Geometry.circular(500.0, 800.0, np.array([angle]), Panel(pixels, pixels, pitch)).ray_frames()[0]


def log_error(found, brute: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    return np.abs(np.log(found.counts[:, pixels[:, 0], pixels[:, 1]].T / brute))


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.9])
def test_nested_cylinders_against_many_rays(angle: float) -> None:
    frame, solids = frame_of(64, 3.2, angle), solids_of(NESTED)
    found = expected_counts(frame, 64, 64, solids, SPECTRUM)
    pixels = np.argwhere(found.classes != EMPTY)[::7]
    error = log_error(found, expected_counts_by_grid(frame, pixels, solids, SPECTRUM, n=128), pixels)
    assert np.sqrt((error**2).mean()) < 2e-4
    assert error.max() < 3e-3  # pixels four times as wide as the preset's, and rays that are not enough themselves


def test_brute_converges_to_it() -> None:
    frame, solids = frame_of(64, 3.2), solids_of(NESTED)
    found = expected_counts(frame, 64, 64, solids, SPECTRUM)
    pixels = np.argwhere(found.classes == CROSSED)[::29]
    errors = [
        log_error(found, expected_counts_by_grid(frame, pixels, solids, SPECTRUM, n=n), pixels).max()
        for n in (16, 64, 512)
    ]
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 3e-4


def test_brute_is_the_definition() -> None:
    objects = [(Ellipsoid((3, 2, 1), (10, 40, 20), (1, 2, 3)), 0), (Box((20, 0, 0), (30, 20, 25), (3, 2, 1)), 1)]
    frame, solids = frame_of(16, 12.8), solids_of(objects)
    for pixel in ((7, 8), (6, 6), (9, 10)):
        expected = expected_counts_of_pixel(frame, pixel, solids, SPECTRUM, n=5, background=3)
        found = expected_counts_by_grid(frame, np.array([pixel]), solids, SPECTRUM, background=3, n=5)
        np.testing.assert_allclose(found[0], expected, rtol=1e-12)


def test_box_face_on_is_exact() -> None:
    """A box of 10 mm seen along its faces, in parallel to a very distant source: areas and one exponential."""
    frame = Geometry.circular(1e7, 1e7 + 100, np.zeros(1), Panel(9, 9, 3.0)).ray_frames()[0]
    found = expected_counts(frame, 9, 9, solids_of([(Box((0, 0, 0), (10, 10, 10)), 0)]), SPECTRUM)
    covered = np.clip(5 - np.abs(np.arange(-4, 5) * 3.0) + 1.5, 0, 3) / 3
    hit = np.outer(covered, covered)
    expected = WEIGHTS[:, None, None] * (1 - hit * -np.expm1(-10 * ATTENUATION[0])[:, None, None])
    np.testing.assert_allclose(found.counts, expected, rtol=2e-5)


def test_effort_goes_where_it_is_needed() -> None:
    found = expected_counts(frame_of(128, 1.6), 128, 128, solids_of(NESTED), SPECTRUM)
    share = {kind: (found.classes == kind).mean() for kind in (EMPTY, SMOOTH, NEAR, CROSSED)}
    assert share[EMPTY] > 0.1
    assert share[EMPTY] + share[SMOOTH] > 0.5
    assert share[CROSSED] < 0.12
    assert found.rays.sum() < 8 * found.classes.size
    assert (found.counts[:, found.classes == EMPTY] == WEIGHTS[:, None]).all()


def test_air_needs_no_ray_and_background_does() -> None:
    nothing = solids_of([])
    frame = frame_of(8, 3.2)
    assert expected_counts(frame, 8, 8, nothing, SPECTRUM).rays.sum() == 0
    found = expected_counts(frame, 8, 8, nothing, SPECTRUM, background=0)
    length = np.linalg.norm(frame[1] + 3 * frame[2] + 4 * frame[3])
    centre = WEIGHTS * np.exp(-length * ATTENUATION[0])
    np.testing.assert_allclose(found.counts[:, 4, 3], centre, rtol=1e-4)  # the pixel's average differs by that much


def test_same_counts_whatever_the_threads() -> None:
    frames = [frame_of(32, 6.4, angle) for angle in (0.0, 0.5, 1.0, 1.5)]
    solids = solids_of(NESTED)
    results = []
    for threads in (1, 3):
        set_threads(threads)
        results.append(
            list(run_parallel(lambda frame: expected_counts(frame, 32, 32, solids, SPECTRUM).counts, frames))
        )
    set_threads(None)
    np.testing.assert_array_equal(results[0], results[1])


@pytest.mark.wrong_types
def test_refuses_spectrum_that_does_not_match() -> None:
    with pytest.raises(InputError, match="do not match"):
        expected_counts(frame_of(4, 1.0), 4, 4, solids_of(NESTED), Spectrum(ATTENUATION, WEIGHTS[:3], STARTS))


@pytest.mark.parametrize(
    "shape",
    [
        Sphere((3, 2, 1), 30.0),
        Ellipsoid((3, 2, 1), (10, 40, 20), (1, 2, 3)),
        Cylinder((3, 2, 1), (20, 10), 50.0, (1, 2, 3)),
        Box((3, 2, 1), (20, 30, 40), (1, 2, 3)),
    ],
    ids=lambda shape: type(shape).__name__,
)
def test_silhouettes_enclose_the_shadow(shape: Shape) -> None:
    """Where a ray begins to hit and where it ceases to, some form vanishes; all hits lie within the bounds."""
    frame, solids = frame_of(32, 8.0), solids_of([(shape, 0)])
    outline = cone_silhouettes(frame, solids.kinds, solids.locals_)
    u = np.linspace(0, 31, 20_001)
    directions = frame[1] + u[:, None] * frame[2] + 15.3 * frame[3]
    hit = trace(np.tile(frame[0], (len(u), 1)), directions, solids, 1)[:, 0] > 0
    low_u, high_u, low_v, high_v = outline.bounds[0]
    assert low_u <= u[hit].min()
    assert u[hit].max() <= high_u
    assert low_v <= 15.3 <= high_v
    monomials = np.stack([u**0, u, u * 0 + 15.3, u**2, 15.3 * u, u * 0 + 15.3**2])
    changes = np.diff(np.sign(outline.forms @ monomials), axis=1) != 0
    for i in np.flatnonzero(np.diff(hit)):
        assert changes[:, max(0, i - 1) : i + 2].any()


def test_column_of_a_cylinder_along_the_rays_has_only_its_rims() -> None:
    frame = np.array([[0, 0, 10.0], [-8, -8, -5], [1, 0, 0], [0, 1, 0]])
    outline = parallel_silhouettes(frame, *solids_of([(Cylinder((0, 0, 0), 3.0, 4.0), 0)])[:2])
    assert outline.roots.tolist() == [0, 0]
    a, b, c, _, e, f = outline.forms[0] / outline.forms[0, 3]
    np.testing.assert_allclose([a, b, c, e, f], [128 - 9, -16, -16, 0, 1], atol=1e-12)


def crowd(count: int) -> list[tuple[Shape, int]]:
    """A cylinder with small solids of all kinds in it, some of which overlap."""
    rng = np.random.default_rng(3)
    found: list[tuple[Shape, int]] = [(Cylinder((0, 0, 0), 50.0, 100.0), 0)]
    for i in range(count):
        center, size = tuple(rng.uniform(-32, 32, 3)), rng.uniform(2, 6)
        axis, angles, material = tuple(rng.normal(size=3)), tuple(rng.uniform(0, 6, 3)), int(rng.integers(4))
        shape = (
            Sphere(center, size),
            Ellipsoid(center, (size, size / 2, size), angles),
            Box(center, (size, size, 2 * size), angles),
            Cone(center, (size, 1.0), 2 * size, axis),
            Capsule(center, size / 2, size, axis),
            Tube(center, size, size / 2, size, axis),
            Union((Sphere(center, size), Box(center, (2 * size, size, size)))),
        )[i % 7]
        found.append((shape, material))
    return found


def test_many_objects_are_traced_like_the_definition() -> None:
    """Rays that look at near objects only find what rays that sort all crossings find."""
    frame, solids = frame_of(48, 4.3), solids_of(crowd(120))
    found = expected_counts(frame, 48, 48, solids, SPECTRUM, sampling=Sampling(sub_rays=1))
    directions = np.array([frame[1] + c * frame[2] + r * frame[3] for r in range(48) for c in range(48)])
    lengths = trace(np.tile(frame[0], (48 * 48, 1)), directions, solids, 4)
    for i in range(7, 48 * 48, 497):
        np.testing.assert_allclose(lengths[i], trace_one(frame[0], directions[i], solids, 4), atol=1e-9)
    counts = WEIGHTS * np.exp(-lengths @ ATTENUATION)
    np.testing.assert_allclose(found.counts.reshape(4, -1).T, counts, rtol=1e-6)


def test_a_plain_grid_is_the_mean_of_its_rays_and_converges() -> None:
    frame, solids = frame_of(48, 4.3), solids_of(crowd(60))
    exact = expected_counts(frame, 48, 48, solids, SPECTRUM, sampling=Sampling(sub_rays=16))
    pixels = np.argwhere(exact.classes == CROSSED)[::25]
    coarse = expected_counts(frame, 48, 48, solids, SPECTRUM, sampling=Sampling(sub_rays=4))
    np.testing.assert_allclose(
        coarse.counts[:, pixels[:, 0], pixels[:, 1]].T,
        expected_counts_by_grid(frame, pixels, solids, SPECTRUM, n=4),
        rtol=1e-12,
    )
    brute = expected_counts_by_grid(frame, pixels, solids, SPECTRUM, n=96)
    found = [expected_counts(frame, 48, 48, solids, SPECTRUM, sampling=Sampling(sub_rays=n)) for n in (1, 4, 16)]
    errors = [log_error(each, brute, pixels) for each in found]
    assert errors[0].mean() > 8 * errors[1].mean() > 64 * errors[2].mean()


@pytest.mark.parametrize("sub_rays", [0, 17])
def test_refuses_impossible_sub_rays(sub_rays: int) -> None:
    with pytest.raises(InputError, match=f"1 to 16, got {sub_rays}"):
        expected_counts(frame_of(4, 1.0), 4, 4, solids_of(NESTED), SPECTRUM, sampling=Sampling(sub_rays=sub_rays))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 40), st.integers(1, 40))
def test_tiles_list_what_meets_them(seed: int, rows: int, columns: int) -> None:
    rng = np.random.default_rng(seed)
    low = rng.uniform(-20, 50, (12, 2))
    high = low + rng.exponential(6, (12, 2))
    bounds = np.stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]], axis=1)
    bounds[0] = -np.inf, np.inf, -np.inf, np.inf
    tiles = Tiles.of(bounds, np.arange(12), rows, columns)
    for row, column in np.ndindex(rows, columns):
        tile = row // TILE * tiles.across + column // TILE
        listed = tiles.members[tiles.starts[tile] : tiles.starts[tile + 1]]
        assert (np.diff(listed) > 0).all()
        place = np.array([column, row])
        meets = ((low - 0.5 <= place) & (place <= high + 0.5)).all(axis=1)
        meets[0] = True
        assert set(np.flatnonzero(meets)) <= set(listed)


coefficient = st.floats(-1, 1)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(*[coefficient] * 6), min_size=0, max_size=3), st.booleans())
def test_nodes_tile_the_square(conics: list[tuple], tangent: bool) -> None:
    rules = make_rules((6, 6))
    room = make_room(rules)
    for i, conic in enumerate(conics):
        room.local[i] = [*conic, 1e-15, float(tangent)]
    count = square_nodes(room.local, len(conics), rules.nodes[0], rules.sizes[0], room.lines, room.nodes, 0)
    a, b, weight, _ = room.nodes[:count].T
    assert weight.sum() == pytest.approx(1, abs=2e-4)
    assert (weight * a).sum() == pytest.approx(0, abs=2e-4)
    assert (weight * a * b).sum() == pytest.approx(0, abs=2e-4)
    assert np.abs(a).max() <= 0.5 + 1e-9
    assert np.abs(b).max() <= 0.5 + 1e-9
    assert weight.min() >= 0


@pytest.mark.parametrize(("x", "y", "radius"), [(0.1, -0.2, 0.2), (0.7, 0.1, 0.6), (0.4, 0.4, 0.3), (3.0, 0.0, 2.8)])
def test_nodes_integrate_the_height_of_a_ball(x: float, y: float, radius: float) -> None:
    rules = make_rules((3, 3), (8, 8))
    room = make_room(rules)
    errors = []
    for level in range(2):
        room.local[0] = [radius**2 - x**2 - y**2, 2 * x, 2 * y, -1, 0, -1, 1e-15, 1]
        count = square_nodes(room.local, 1, rules.nodes[level], rules.sizes[level], room.lines, room.nodes, 0)
        a, b, weight, _ = room.nodes[:count].T
        height = np.sqrt(np.maximum(0, radius**2 - (a - x) ** 2 - (b - y) ** 2))
        s = (np.arange(3000) + 0.5) / 3000 - 0.5
        many = np.sqrt(np.maximum(0, radius**2 - (s[:, None] - x) ** 2 - (s - y) ** 2)).mean()
        errors.append(abs((weight * height).sum() / many - 1))
    assert errors[0] < 3e-3
    assert errors[1] < 2e-5


def test_too_many_conics_fall_back_to_a_grid() -> None:
    rules = make_rules((3, 2))
    room = make_room(rules)
    count = square_nodes(room.local, CONICS + 1, rules.nodes[0], rules.sizes[0], room.lines, room.nodes, 0)
    assert room.nodes[:count, 2].sum() == pytest.approx(1)
    crowd = [(Cylinder((0, 0, 0), 1.0 + 0.01 * i, 10.0), i % 4) for i in range(12)][::-1]
    frame, solids = frame_of(24, 0.8), solids_of(crowd)
    found = expected_counts(frame, 24, 24, solids, SPECTRUM)
    pixels = np.argwhere(found.classes == CROSSED)
    error = log_error(found, expected_counts_by_grid(frame, pixels, solids, SPECTRUM, n=96), pixels)
    assert error.max() < 5e-3
