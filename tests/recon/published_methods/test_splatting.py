"""Published methods that splat: gaussian-mono, ellipsoid and x-gaussian on small scenes of Gaussians."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from support.orbit_scenes import GRID, blobs, circle, relative_error

from phantomgen.geometry.orbits import parallel
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from recon.published_methods.paper.model import FactorisedGaussians, Units
from recon.published_methods.paper.recipe import PaperRecipe
from recon.published_methods.splatting.primitives import Attenuation, Radiance
from recon.published_methods.splatting.r2_gaussian import GaussianMono
from recon.published_methods.splatting.x_field import Chords, Ellipsoid
from recon.published_methods.splatting.x_gaussian import XGaussian
from recon.voxel.method import ViewMethod
from spectra.errors import InputError
from spectra.threads import set_threads

VOLUMES = {
    "gaussian-mono": GaussianMono(60, gaussians=400, most=600, patch=8),
    "ellipsoid": Ellipsoid(60, gaussians=400, most=600),
}
UNITS = Units.of(GRID, 0.02, 0.0005, 0.5)


@pytest.fixture(scope="module")
def scan():
    """Line integrals of two blobs in two bases, and their poses."""
    geometry = circle(24)
    return np.moveaxis(blobs().line_integrals(geometry).numpy(), 1, 0).copy(), geometry


def elongated(centre=(2.0, -1.0, 1.0), sigma=(1.0, 4.0, 2.0)):
    model = FactorisedGaussians.of(np.array([centre]), np.array([0.01]), np.array([sigma]), np.ones((1, 1)), UNITS)
    model.quaternions = torch.tensor([[0.9, 0.1, -0.3, 0.2]])
    return model


def with_fine_pixels(geometry):
    """The same poses with finer pixels, so that one of them is near the peak."""
    steps = (geometry.column_step / 4, geometry.row_step / 4)
    return Geometry(geometry.source, geometry.panel_center, *steps, Panel(160, 192, 0.4))


def told_by(method, scan, **more):
    told = []
    images, geometry = scan
    volumes = method.reconstruct(images, None, geometry, GRID, on_iteration=told.append, **more)
    return volumes, told


@pytest.mark.parametrize("name", VOLUMES)
def test_volumes_get_better_than_their_start(scan, name):
    volumes, told = told_by(replace(VOLUMES[name], pace=3.0), scan)
    truth = blobs().volume(GRID)
    assert volumes.shape == truth.shape
    assert volumes.dtype == np.float32
    first, last = (relative_error(v, truth) for v in (told[0].volumes, volumes))
    assert last < 0.7 * first
    assert last < 0.3 * relative_error(0 * truth, truth)
    assert told[-1].residual < 0.5 * told[0].residual
    assert [i.done for i in told] == [10, 20, 30, 40, 50, 60]
    np.testing.assert_array_equal(told[-1].volumes, volumes)


@pytest.mark.parametrize("name", VOLUMES)
def test_threads_and_runs_give_the_same_bits(scan, name):
    found = []
    for threads in (1, 2):
        set_threads(threads)
        found.append(told_by(replace(VOLUMES[name], iterations=8), scan)[0])
    set_threads(None)
    np.testing.assert_array_equal(*found)
    other = told_by(replace(VOLUMES[name], iterations=8, seed=1), scan)[0]
    assert np.abs(other - found[0]).max() > 0


@pytest.mark.parametrize("name", VOLUMES)
def test_a_channel_that_shows_nothing_stays_empty_beside_others(scan, name):
    images, geometry = scan
    both = told_by(replace(VOLUMES[name], iterations=8), (images, geometry))[0]
    beside = told_by(replace(VOLUMES[name], iterations=8), (np.stack([images[0], 0 * images[1]]), geometry))[0]
    assert not beside[1].any()
    np.testing.assert_array_equal(beside[0], both[0])


def test_rays_that_were_not_measured_do_not_count(scan):
    images, geometry = scan
    weights = np.ones(images.shape[1:], np.float32)
    weights[:, 20, 24] = 0
    spoilt = images.copy()
    spoilt[:, :, 20, 24] = 50.0
    method = XGaussian(8, gaussians=200)
    views = [method.learn_views(i, weights, geometry, GRID) for i in (images, spoilt)]
    np.testing.assert_array_equal(*(v(geometry[:2]) for v in views))


@pytest.mark.parametrize("look", [Attenuation(), Chords()])
def test_projections_and_volume_of_a_kind_hold_the_same_mass(look):
    """Sum over a parallel panel times the pixel's area is the volume's sum times the voxel's, within 1 %."""
    model, geometry = elongated(), parallel(300, np.array([0.3, 1.2]), Panel(90, 90, 0.5))
    with torch.no_grad():
        images = look.images(model.centres, model, UNITS, geometry)
        volume = look.volume(model, UNITS, GRID)
    mass = volume.sum(dtype=float) * np.prod(GRID.spacing)
    np.testing.assert_allclose(images.sum(dim=(1, 2, 3)) * 0.25, mass, rtol=0.01)


def test_a_radiative_gaussian_is_as_bright_from_every_side():
    """Its peak on the panel is its radiance, where attenuation peaks at what a ray meets: less along short axes."""
    model, geometry = elongated(), with_fine_pixels(circle(12))
    with torch.no_grad():
        shown = Radiance().images(model.centres, model, UNITS, geometry).amax(dim=(1, 2, 3))
        met = Attenuation().images(model.centres, model, UNITS, geometry).amax(dim=(1, 2, 3))
    np.testing.assert_allclose(shown, float(UNITS.density * model.density()), rtol=0.01)
    assert float(met.max() / met.min()) > 1.5


def test_x_gaussian_predicts_views_it_has_not_seen(scan):
    """Far better than no object at all, and better after more steps."""
    images, geometry = scan
    told = []
    method = XGaussian(80, gaussians=500, most=800, pace=10.0)
    assert isinstance(method, ViewMethod)
    views = method.learn_views(images[:, ::2], None, geometry[::2], GRID, told.append)
    errors = [float(np.square(views(geometry[1::2]) - images[:, 1::2]).mean())]
    assert errors[0] < 0.3 * np.square(images[:, 1::2]).mean()
    assert views(geometry[:3]).shape == (2, 3, *images.shape[2:])
    assert told[-1].residual < 0.5 * told[0].residual
    assert told[-1].volumes.size == 0
    np.testing.assert_array_equal(told[-1].views(geometry[:1]), views(geometry[:1]))


def test_densification_adds_primitives_up_to_the_most(scan):
    """With a threshold that every gradient passes; without densification there are as many as at the start."""
    images, geometry = scan
    counts = []
    for threshold in (1e-12, 1e3):
        method = XGaussian(30, gaussians=64, most=100, clone_gradient=threshold)
        views = method.learn_views(images[:1], None, geometry, GRID)
        counts.append(len(views.trainings[0].model))
    assert 64 < counts[0] <= 100
    assert counts[1] <= 64


@pytest.mark.parametrize("kind", [GaussianMono, Ellipsoid, XGaussian])
def test_a_recipe_has_every_setting_of_its_method(kind):
    method = kind(7, gaussians=11, most=13, dssim=0.1, clone_gradient=1e-3, pace=2.0, seed=5)
    recipe, usual = method.recipe, PaperRecipe()
    own = dict(vars(method))
    assert recipe.steps == own.pop("iterations")
    factor = own.pop("pace")
    assert {name: getattr(recipe, name) for name in own} == own
    for name in ("centre_rate", "density_rate", "scale_rate", "rotation_rate"):
        assert getattr(recipe, name).first == factor * getattr(usual, name).first
        assert getattr(recipe, name).last == factor * getattr(usual, name).last


@pytest.mark.parametrize("kind", [GaussianMono, Ellipsoid, XGaussian])
@pytest.mark.parametrize("name", ["iterations", "gaussians", "most"])
def test_numbers_that_cannot_be_are_one_sentence(scan, kind, name):
    images, geometry = scan
    method = kind(**{name: 0})
    run = method.learn_views if kind is XGaussian else method.reconstruct
    with pytest.raises(InputError, match="must be positive, got 0"):
        run(images, None, geometry, GRID)
