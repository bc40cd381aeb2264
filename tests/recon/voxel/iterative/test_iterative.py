"""SIRT, OS-SART and CGLS against dense matrices, and on orbits of every kind."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse.linalg import lsqr
from support.gaussian_scenes import tilted
from support.orbit_scenes import FILTERED, GRID, ITERATED, blobs, circle, relative_error
from support.tolerances import TOLERANCES

from phantomgen.geometry.voxel_grid import Grid
from recon.runs.methods import METHODS, method_named
from recon.voxel.iterative.cgls import Cgls
from recon.voxel.iterative.iteration import IterativeMethod
from recon.voxel.iterative.sart import Sart, ordered_subsets
from recon.voxel.iterative.sirt import Sirt
from recon.voxel.method import CountsMethod, LinearMethod, ViewMethod
from recon.voxel.projector_pair import ProjectorPair
from spectra.errors import GeometryError, InputError
from spectra.threads import set_threads

SMALL, FREE = Grid((5, 6, 7), (1.5, 1.4, 1.3), (-3.0, -3.5, -3.9)), tilted(views=5)
SHAPE = (5, FREE.panel.rows, FREE.panel.columns)
INCOMPLETE = {"limited arc", "laminography", "tilted parallel beam", "panel beside the axis"}
ITERATIVE = {"sirt": Sirt(3), "sart": Sart(2), "cgls": Cgls(3)}


@pytest.fixture(scope="module")
def system():
    """Matrix, noisy images of two bases, and weights, all small."""
    rng, pair = np.random.default_rng(1), ProjectorPair(FREE, SMALL)
    units = np.eye(np.prod(SMALL.shape), dtype=np.float32).reshape(-1, *SMALL.shape)
    matrix = pair.project(units).reshape(len(units), -1).T.astype(float)
    images = matrix @ rng.uniform(0, 1, (matrix.shape[1], 2)) + rng.normal(0, 0.5, (len(matrix), 2))
    return matrix, images.T.reshape(2, *SHAPE).astype(np.float32), rng.uniform(0.2, 1, SHAPE).astype(np.float32)


@pytest.mark.parametrize("weighted", [False, True])
def test_cgls_descends_as_lsqr_does(system, weighted):
    matrix, images, weights = system
    told = []
    chosen = weights if weighted else None
    volumes = Cgls(8).reconstruct(images[:1], chosen, FREE, SMALL, lambda i: told.append(i.residual))
    root = np.sqrt(weights.ravel()) if weighted else np.ones(len(matrix))
    data = root * images[0].ravel()
    for done in (1, 4, 8):
        right = lsqr(root[:, None] * matrix, data, atol=0, btol=0, conlim=0, iter_lim=done)
        assert told[done - 1] == pytest.approx(right[3] / np.linalg.norm(data), rel=TOLERANCES["iterative"])
    scale = np.abs(right[0]).max()
    np.testing.assert_allclose(volumes.ravel(), right[0], atol=20 * TOLERANCES["iterative"] * scale)


@pytest.mark.parametrize("subsets", [1, 3])
def test_sart_is_its_formula(system, subsets):
    """In float64 with a dense matrix; rays and voxels that are hardly met are left out in both."""
    matrix, images, weights = system
    found = Sart(2, subsets, 0.8, 0.5, non_negative=False).reconstruct(images, weights, FREE, SMALL)
    x = np.zeros((matrix.shape[1], 2))
    by_view, data, w = matrix.reshape(5, -1, len(x)), images.reshape(2, 5, -1), weights.reshape(5, -1)
    lengths = by_view.sum(axis=2)
    for sweep in range(2):
        for views in ordered_subsets(5, subsets):
            a = by_view[views].reshape(-1, len(x))
            met = (lengths > 0.01 * lengths.max())[views].ravel()
            a, b, ray_weights = a[met], data[:, views].reshape(2, -1).T[met], w[views].ravel()[met]
            sums = (a * ray_weights[:, None]).sum(axis=0)
            scale = np.divide(1, sums, out=np.zeros_like(sums), where=sums > 1e-3 * sums.max())
            step = a.T @ ((ray_weights / a.sum(axis=1))[:, None] * (b - a @ x))
            x += 0.8 * 0.5**sweep * scale[:, None] * step
    np.testing.assert_allclose(found.reshape(2, -1).T, x, atol=TOLERANCES["iterative"] * np.abs(x).max())


def test_sirt_is_sart_of_one_subset(system):
    _, images, weights = system
    sirt, sart = (method.reconstruct(images, weights, FREE, SMALL) for method in (Sirt(3, 1.2), Sart(3, 1, 1.2, 1.0)))
    np.testing.assert_allclose(sirt, sart, rtol=1e-4, atol=1e-6)


class Countdown(IterativeMethod):
    """Updates that leave -1 behind, three a pass, so that the loop alone decides what comes out."""

    iterations, non_negative = 2, True

    def update_rule(self, system):
        def update(volumes, done):
            for part in range(3):
                assert volumes.min() == 0
                volumes[:] = -1
                yield 10.0 * done + part

        return update


def test_the_loop_clips_after_each_update_and_tells_of_each_pass(system):
    told = []
    volumes = Countdown().reconstruct(
        system[1], None, FREE, SMALL, lambda i: told.append((i.done, i.total, i.residual))
    )
    assert told == [(1, 2, 12.0), (2, 2, 22.0)]
    assert volumes.shape == (2, *SMALL.shape)
    assert not volumes.any()


@pytest.mark.parametrize("name", ["sirt", "cgls"])
def test_residuals_fall(system, name):
    told = []
    ITERATIVE[name].reconstruct(system[1], None, FREE, SMALL, lambda i: told.append(i.residual))
    assert told == sorted(told, reverse=True)
    assert told[-1] < 0.9 * told[0]


@pytest.mark.parametrize("name", ["sirt", "sart"])
def test_nothing_is_negative(system, name):
    assert ITERATIVE[name].reconstruct(-system[1], None, FREE, SMALL).min() >= 0
    free = replace(ITERATIVE[name], non_negative=False)
    assert (free.reconstruct(-system[1], None, FREE, SMALL) < 0).any()


@pytest.mark.parametrize("name", ITERATIVE)
def test_bases_do_not_know_of_each_other(system, name):
    together = ITERATIVE[name].reconstruct(system[1], None, FREE, SMALL)
    alone = [ITERATIVE[name].reconstruct(image[None], None, FREE, SMALL)[0] for image in system[1]]
    np.testing.assert_allclose(together, alone, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("name", ITERATIVE)
def test_rays_without_weight_may_hold_anything(system, name):
    _, images, weights = system
    seen = (weights > 0.5).astype(np.float32)
    right = ITERATIVE[name].reconstruct(images * seen, seen, FREE, SMALL)
    other = ITERATIVE[name].reconstruct(np.where(seen > 0, images, 1e3), seen, FREE, SMALL)
    np.testing.assert_allclose(other, right, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("name", ITERATIVE)
def test_any_number_of_threads_gives_the_same_bits(system, name):
    volumes = []
    try:
        for threads in (1, 3):
            set_threads(threads)
            volumes.append(ITERATIVE[name].reconstruct(system[1], None, FREE, SMALL))
    finally:
        set_threads(None)
    np.testing.assert_array_equal(*volumes)


@pytest.mark.parametrize("name", ITERATIVE)
def test_empty_images_give_empty_volumes(name):
    assert not ITERATIVE[name].reconstruct(np.zeros((1, *SHAPE), np.float32), None, FREE, SMALL).any()


def test_a_volume_that_no_ray_meets_is_refused():
    far = Grid((4, 4, 4), (1.0, 1.0, 1.0), (0.0, 900.0, 0.0))
    with pytest.raises(GeometryError, match="no ray of the 5 views meets the volume"):
        Cgls().reconstruct(np.zeros((1, *SHAPE), np.float32), None, FREE, far)


@pytest.mark.parametrize("orbit", [*ITERATED, "half-fan", "half a turn, parallel"])
def test_sart_finds_blobs_from_any_orbit(orbit):
    """Errors fall far below that of a volume of zeros, less far where rays through some places are missing."""
    geometry, truth = (ITERATED | FILTERED)[orbit], blobs()
    images, expected = np.moveaxis(truth.line_integrals(geometry).numpy(), 1, 0), truth.volume(GRID)
    volumes = Sart().reconstruct(images, None, geometry, GRID)
    error = relative_error(volumes, expected) / relative_error(0 * expected, expected)
    assert error < (0.3 if orbit in INCOMPLETE else 0.08)


@pytest.mark.parametrize("name", ["sirt", "cgls"])
def test_others_find_blobs_too(name):
    geometry, truth = circle(36), blobs()
    images, expected = np.moveaxis(truth.line_integrals(geometry).numpy(), 1, 0), truth.volume(GRID)
    volumes = method_named(name, 15).reconstruct(images, None, geometry, GRID)
    assert relative_error(volumes, expected) < 0.08 * relative_error(0 * expected, expected)


@pytest.mark.parametrize(("views", "count"), [(75, 90), (1, 1), (60, 7), (200, 90)])
def test_subsets_hold_every_view_once(views, count):
    subsets = ordered_subsets(views, count)
    assert len(subsets) == min(views, count)
    assert sorted(np.concatenate(subsets).tolist()) == list(range(views))


@pytest.mark.parametrize("name", METHODS)
def test_the_table_makes_methods_that_know_their_name(name):
    method = method_named(name)
    assert method.name == name
    assert sum(isinstance(method, kind) for kind in (LinearMethod, CountsMethod, ViewMethod)) == 1


@pytest.mark.parametrize(
    ("arguments", "words"), [(("tv",), "there is no method tv"), (("fdk", 3), "fdk has no number of iterations")]
)
def test_what_the_table_lacks_is_refused(arguments, words):
    with pytest.raises(InputError, match=words):
        method_named(*arguments)
