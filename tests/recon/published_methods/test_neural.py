"""Networks as published methods: rays and points, features, segments, volumes that are read off, and small fits."""

import numpy as np
import pytest
import torch
from support.gaussian_scenes import tilted
from support.orbit_scenes import GRID, blobs, circle, relative_error

from phantomgen.geometry.orbits import parallel
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.voxel_grid import Grid
from recon.published_methods.neural.naf import Neural
from recon.published_methods.neural.networks import SEGMENT, FeatureGrids, Lineformer
from recon.published_methods.neural.rays import WINDOW, Rays
from recon.published_methods.neural.sax_nerf import SaxNerf
from recon.published_methods.neural.training import read
from spectra.errors import GeometryError, InputError

SMALL = Grid((5, 6, 7), (1.5, 1.4, 1.3), (-3.0, -3.5, -3.9))
METHODS = {
    "neural": Neural(120, rays=400, points=24, levels=3, rate=0.1),
    "sax-nerf": SaxNerf(120, rays=256, points=24, levels=3, hidden=16, blocks=1, rate=0.1),
}


@pytest.fixture(scope="module")
def scan():
    geometry = circle(24)
    return np.moveaxis(blobs().line_integrals(geometry).numpy(), 1, 0).copy(), geometry


FREE = tilted(views=5)
UPRIGHT = parallel(300, np.array([0.0, np.pi / 2]), Panel(8, 8, 1.0))  # directions with zeros


@pytest.mark.parametrize("count", [1, 5])
@pytest.mark.parametrize("geometry", [FREE, UPRIGHT], ids=["free poses", "along an axis"])
def test_points_stand_for_the_whole_way_through_the_grid(geometry, count):
    """They lie in the box, and their steps add up to the part of the ray that does, as 20 000 points on it tell."""
    shape = (len(geometry), geometry.panel.rows, geometry.panel.columns)
    images = np.random.default_rng(0).uniform(size=(2, *shape)).astype(np.float32)
    rays = Rays(images, None, geometry, SMALL, seed=0)
    numbers = rays.anywhere(100)
    points = rays.points(numbers, count)
    view, row, column = np.unravel_index(numbers, shape)
    source, first, column_step, row_step = np.moveaxis(geometry.ray_frames()[view], 1, 0)
    along = first + column[:, None] * column_step + row[:, None] * row_step
    middle = np.array(SMALL.origin[::-1]) + (np.array(SMALL.shape[::-1]) - 1) / 2 * SMALL.spacing[::-1]
    half = np.array(SMALL.shape[::-1]) * SMALL.spacing[::-1] / 2
    speed = np.linalg.norm(along, axis=1, keepdims=True)
    nearest = ((middle - source) * along).sum(axis=1, keepdims=True) / speed**2
    t = nearest + np.linspace(-10, 10, 20_001) / speed  # the box is 13 mm across
    places = source[:, None] + t[..., None] * along[:, None]
    length = 20 * (np.abs(places - middle) < half).all(axis=2).mean(axis=1)
    np.testing.assert_allclose(count * points.steps[:, 0], length, atol=0.005)
    assert points.places.shape == (100, count, 3)
    assert float(points.places[points.steps[:, 0] > 1e-4].abs().max()) <= 1 + 1e-5
    np.testing.assert_array_equal(rays.measured(numbers), images.reshape(2, -1)[:, numbers].T)


def test_half_of_masked_rays_come_in_windows_in_front_of_the_object(scan):
    images, geometry = scan
    rays = Rays(images, None, geometry, GRID, seed=0)
    bright = images.max(axis=0).ravel()
    chosen = rays.masked(4 * WINDOW**2)
    local, anywhere = chosen[: 2 * WINDOW**2], chosen[2 * WINDOW**2 :]
    assert bright[local].mean() > 2 * bright[anywhere].mean()
    assert (bright[anywhere] == 0).any()
    for window in local.reshape(2, -1):
        _, row, column = np.unravel_index(window, images.shape[1:])
        assert (np.ptp(row), np.ptp(column)) == (WINDOW - 1, WINDOW - 1)
        assert len(np.unique(window)) == WINDOW**2


@pytest.mark.parametrize("choose", ["anywhere", "masked"])
def test_rays_that_were_not_measured_are_never_chosen(scan, choose):
    images, geometry = scan
    weights = np.ones(images.shape[1:], np.float32)
    weights[:, ::2] = 0
    chosen = getattr(Rays(images, weights, geometry, GRID, seed=0), choose)(500)
    assert weights.ravel()[chosen].all()


def test_features_are_linear_between_nodes():
    grids = FeatureGrids(levels=2, coarsest=3, finest=5, features=1)
    with torch.no_grad():
        for grid in grids.grids:
            axis = torch.linspace(-1, 1, grid.shape[-1])
            z, y, x = torch.meshgrid(axis, axis, axis, indexing="ij")
            grid.copy_((x + 10 * y + 100 * z)[None, None])
    places = torch.from_numpy(np.random.default_rng(0).uniform(-1, 1, (4, 6, 3))).float()
    found = grids(places)
    assert found.shape == (4, 6, 2)
    expected = places @ torch.tensor([1.0, 10.0, 100.0])
    torch.testing.assert_close(found, expected[..., None].expand(-1, -1, 2), rtol=1e-4, atol=1e-4)


def test_points_attend_to_their_segment_and_to_no_other():
    torch_rng = torch.Generator().manual_seed(0)
    network = Lineformer(4, 8, blocks=2, heads=2, outputs=3)
    features = torch.rand(2, 2 * SEGMENT, 4, generator=torch_rng)
    moved = features.clone()
    moved[1, 3] += 1
    with torch.no_grad():
        change = (network(moved) - network(features)).abs().amax(dim=2)
    assert (change[1, :SEGMENT] > 0).all()
    assert not change[0].any()
    assert not change[1, SEGMENT:].any()


@pytest.mark.parametrize("shape", [(3, 4, 5), (2, 3, 16)])
def test_volumes_are_read_at_the_centres_of_voxels(shape):
    """A field that answers with the place gives the centres' coordinates, in (z, y, x) order."""
    grid = Grid(shape, (1.0, 1.0, 1.0), tuple(-(n - 1) / 2 for n in shape))
    volumes = read(lambda places: places, grid)
    z, y, x = np.meshgrid(*(grid.axis(name) / (n / 2) for name, n in zip("zyx", shape, strict=True)), indexing="ij")
    np.testing.assert_allclose(volumes, [x, y, z], atol=1e-6)


@pytest.mark.parametrize("name", METHODS)
def test_networks_find_blobs(scan, name):
    images, geometry = scan
    told, truth = [], blobs().volume(GRID)
    volumes = METHODS[name].reconstruct(images, None, geometry, GRID, told.append)
    assert volumes.shape == truth.shape
    first, last = (relative_error(v, truth) for v in (told[0].volumes, volumes))
    assert last < 0.7 * first
    assert last < 0.4 * relative_error(0 * truth, truth)
    assert told[-1].residual < 0.5 * told[0].residual
    assert told[-1].done == told[-1].total == METHODS[name].iterations


@pytest.mark.parametrize("kind", [Neural, SaxNerf])
def test_the_same_seed_gives_the_same_bits_and_another_does_not(scan, kind):
    images, geometry = scan
    found = [
        kind(6, rays=128, points=16, levels=2, seed=seed).reconstruct(images, None, geometry, GRID)
        for seed in (0, 0, 1)
    ]
    np.testing.assert_array_equal(found[0], found[1])
    assert np.abs(found[0] - found[2]).max() > 0


def test_a_grid_that_no_ray_meets_is_refused():
    far = Grid((4, 4, 4), (1.0, 1.0, 1.0), (0.0, 900.0, 0.0))
    with pytest.raises(GeometryError, match="no ray of the 5 views meets the volume"):
        Neural(2).reconstruct(np.zeros((1, 5, 14, 11), np.float32), None, tilted(views=5), far)


@pytest.mark.parametrize(
    ("numbers", "words"),
    [
        ({"points": 30}, "points on a ray must be a multiple of 8, got 30"),
        ({"heads": 3}, "must be a multiple of heads"),
    ],
)
def test_sizes_that_do_not_fit_are_one_sentence(numbers, words):
    with pytest.raises(InputError, match=words):
        SaxNerf(**numbers)
