import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import nbinom, poisson
from support.tolerances import TOLERANCES

from recon.ops.deviance import chi_square, deviance, expected_chi_square, expected_deviance


def likelihood_ratio(counts, expected, dispersion):
    if dispersion == 0:
        return 2 * (poisson.logpmf(counts, counts) - poisson.logpmf(counts, expected))
    k = dispersion**-2
    return 2 * (nbinom.logpmf(counts, k, k / (k + counts)) - nbinom.logpmf(counts, k, k / (k + expected)))


@settings(deadline=None)
@given(st.integers(0, 100_000), st.floats(1e-3, 1e5), st.sampled_from([0.0, 0.01, 0.03, 0.5]))
def test_deviance_is_twice_the_log_likelihood_ratio(counts, expected, dispersion):
    got = deviance(*torch.tensor([counts, expected], dtype=torch.float64), dispersion)
    size = counts + expected + 1
    assert float(got) == pytest.approx(
        likelihood_ratio(counts, expected, dispersion), abs=TOLERANCES["deviance"] * size
    )


@pytest.mark.parametrize("dispersion", [0.0, 0.02])
def test_deviance_is_zero_at_the_counts_and_positive_elsewhere(dispersion):
    counts = torch.tensor([0.0, 1.0, 7.0, 1e4], dtype=torch.float64)
    assert deviance(counts, counts, dispersion) == pytest.approx([0] * 4, abs=1e-9)
    assert (deviance(counts, counts + 0.5, dispersion) > 0).all()


@pytest.mark.parametrize("dispersion", [0.0, 0.02])
def test_mean_deviance_is_about_one_where_the_model_is_right(dispersion):
    rng, mean = np.random.default_rng(1), 4e3
    rate = mean if dispersion == 0 else rng.gamma(dispersion**-2, mean * dispersion**2, 20000)
    counts = torch.from_numpy(rng.poisson(rate, 20000)).double()
    assert float(deviance(counts, torch.tensor(mean).double(), dispersion).mean()) == pytest.approx(1, abs=0.04)


@pytest.mark.parametrize("dispersion", [0.0, 0.02])
def test_gradient_is_the_finite_difference(dispersion):
    counts = torch.tensor([0.0, 3.0, 500.0], dtype=torch.float64)
    expected = torch.tensor([0.2, 4.0, 480.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda e: deviance(counts, e, dispersion), expected)


@pytest.mark.parametrize("dispersion", [0.0, 0.01])
def test_single_precision_is_good_enough_for_means(dispersion):
    rng = np.random.default_rng(2)
    expected = rng.uniform(10, 6e4, 10000)
    counts = torch.from_numpy(rng.poisson(expected)).double()
    double = deviance(counts, torch.from_numpy(expected), dispersion).mean()
    single = deviance(counts.float(), torch.from_numpy(expected).float(), dispersion).mean()
    assert float(single) == pytest.approx(float(double), abs=1e-3)


@pytest.mark.parametrize("dispersion", [0.0, 0.01])
@pytest.mark.parametrize("expected", [0.0, 1e-40, 1e-30, 1e-20, 1e-5])
@pytest.mark.parametrize("counts", [0.0, 1.0, 1e4])
def test_starved_rays_have_finite_values_and_gradients(counts, expected, dispersion):
    leaf = torch.tensor([expected], dtype=torch.float32, requires_grad=True)
    value = deviance(torch.tensor([counts]), leaf, dispersion)
    value.backward()
    assert torch.isfinite(value).all()
    assert torch.isfinite(leaf.grad).all()


@pytest.mark.parametrize("dispersion", [0.0, 0.02])
@pytest.mark.parametrize("mean", [3e-4, 0.03, 0.4, 2.0, 9.0, 80.0, 2e3, 3e4])
def test_what_noise_alone_leaves_is_expected(mean, dispersion):
    rng, model = np.random.default_rng(3), torch.tensor(mean).double()
    counts = torch.from_numpy(rng.poisson(mean, 400_000)).double()
    for found, wanted in ((deviance, expected_deviance), (chi_square, expected_chi_square)):
        values = found(counts, model, dispersion)
        error = 5 * float(values.std()) / np.sqrt(len(values)) + 0.01 * float(values.mean())
        assert float(wanted(model, dispersion)) == pytest.approx(float(values.mean()), abs=error)


def test_an_expectation_that_is_not_a_number_spoils_its_own_count_only():
    found = expected_deviance(torch.tensor([5.0, float("nan"), float("inf")]))
    assert found[0] == expected_deviance(torch.tensor([5.0]))[0]
    assert torch.isnan(found[1])
