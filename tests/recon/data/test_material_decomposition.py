import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import nbinom, poisson
from support.gaussian_scenes import spectral_model
from support.tolerances import TOLERANCES

from recon.ops.decompose import CHUNK, PRIOR, decompose
from spectra.errors import InputError
from spectra.threads import set_threads

BOXES = {1: [2.0], 2: [1.0, 1.5], 3: [1.0, 1.5, 0.5]}


def some_rays(model, count, seed):
    """Line integrals, their expected counts, and gains between 0.5 and 1.5."""
    rng = np.random.default_rng(seed)
    lengths = rng.uniform(0, BOXES[len(model.columns)], (count, len(model.columns)))
    gains = rng.uniform(0.5, 1.5, (count, len(model)))
    return lengths, gains * model.expected(lengths), gains


@pytest.mark.parametrize(("bases", "channels"), [(1, 1), (2, 2), (2, 4), (3, 3), (3, 5)])
def test_exact_counts_give_exact_line_integrals(bases, channels):
    model = spectral_model(bases, channels, photons=1e9)
    lengths, counts, gains = some_rays(model, 50, seed=1)
    found, fisher = decompose(counts, gains, model, iterations=60, tolerance=1e-9)
    np.testing.assert_allclose(found, lengths, atol=1e-5)
    slopes = model.jacobian(lengths) * gains[..., None]
    np.testing.assert_allclose(fisher, np.einsum("rc,rcm,rcn->rmn", 1 / counts, slopes, slopes), rtol=1e-3)


@pytest.mark.parametrize("dispersion", [0.0, 0.02])
@pytest.mark.parametrize("bases", [2, 3])
def test_the_likelihood_has_its_maximum_where_scipy_finds_it(bases, dispersion):
    model = spectral_model(bases, photons=3e4)
    _, expected, gains = some_rays(model, 6, seed=2)
    counts = np.random.default_rng(3).poisson(expected).astype(float)

    def likelihood(lengths, y, gain):
        mean = gain * model.expected(lengths)
        terms = poisson.logpmf(y, mean) if dispersion == 0 else nbinom.logpmf(y, k := dispersion**-2, k / (k + mean))
        return PRIOR / 2 * (lengths @ lengths) - terms.sum()

    found, _ = decompose(counts, gains, model, dispersion, tolerance=1e-7)
    for start, y, gain in zip(found, counts, gains, strict=True):
        best = minimize(likelihood, start + 0.1, (y, gain), "Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-9})
        np.testing.assert_allclose(start, best.x, atol=TOLERANCES["decompose_maximum"])


@pytest.mark.parametrize("lengths", [[0.0, 0.0, 0.0], [0.5, 1.0, 0.3], [1.0, 2.0, 0.0]])
def test_estimates_scatter_as_little_as_the_cramer_rao_bound_allows(lengths):
    model, rays = spectral_model(3, photons=1e5), 4000
    counts = np.random.default_rng(4).poisson(model.expected(np.array(lengths)), (rays, len(model))).astype(float)
    found, fisher = decompose(counts, np.ones_like(counts), model)
    bound = np.sqrt(np.diag(np.linalg.inv(model.fisher(np.array(lengths)))))
    np.testing.assert_allclose(found.std(axis=0) / bound, 1, atol=TOLERANCES["efficiency"])
    # the bias of maximum likelihood is of second order, a small part of one standard deviation
    assert (abs(found.mean(axis=0) - lengths) < 0.06 * bound).all()
    np.testing.assert_allclose(fisher.mean(axis=0), model.fisher(np.array(lengths)), rtol=0.02)


def test_fewer_channels_than_bases_are_refused():
    model = spectral_model(3, channels=2)
    with pytest.raises(InputError, match="2 channels cannot tell 3 bases apart"):
        decompose(np.ones((1, 2)), np.ones((1, 2)), model)


def test_chunks_and_threads_do_not_change_a_ray():
    model = spectral_model(2, channels=2)
    _, counts, gains = some_rays(model, CHUNK + 500, seed=5)
    results = []
    try:
        for threads in (1, 3):
            set_threads(threads)
            results.append(decompose(counts, gains, model))
    finally:
        set_threads(None)
    alone = decompose(counts[-3:], gains[-3:], model)
    for one, three, few in zip(*results, alone, strict=True):
        np.testing.assert_array_equal(one, three)
        np.testing.assert_array_equal(one[-3:], few)
