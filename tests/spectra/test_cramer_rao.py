import numpy as np
import pytest

from spectra.cramer_rao import least_deviations
from spectra.transmission import Transmission


def test_the_bound_of_one_parameter_is_that_of_the_formula():
    # One energy, column 1: the line integral of Poisson counts Y has the variance 1 / Y.
    air = Transmission.from_spectrum(np.array([[1e4]]), np.array([[1.0]]))
    assert least_deviations(air.fisher(np.array([0.0])))[0] == pytest.approx(1e-2)
    assert least_deviations(air.fisher(np.array([2.0])))[0] == pytest.approx(np.sqrt(np.exp(2.0) / 1e4))


def test_bounds_are_the_diagonal_of_the_inverse_whatever_the_units():
    rng = np.random.default_rng(0)
    roots = rng.normal(size=(20, 5, 3))
    information = np.einsum("kcm,kcn->kmn", roots, roots)
    expected = np.sqrt(np.diagonal(np.linalg.inv(information), axis1=1, axis2=2))
    np.testing.assert_allclose(least_deviations(information), expected, rtol=1e-9)
    units = np.array([1e-8, 1.0, 1e9])
    np.testing.assert_allclose(least_deviations(information * units * units[:, None]), expected / units, rtol=1e-9)


def test_maximum_likelihood_reaches_the_bound(transmission_on):
    # Two-channel scatter of the linearised estimate, over fresh Poisson counts behind some material.
    transmission, lengths = transmission_on(120), np.array([0.3, 2.0, 0.1])
    counts, jacobian = transmission.expected_and_jacobian(lengths)
    rng = np.random.default_rng(1)
    drawn = rng.poisson(counts, (40_000, len(counts)))
    weighted = jacobian / counts[:, None]
    shifts = (drawn - counts) @ weighted @ np.linalg.inv(jacobian.T @ weighted)
    np.testing.assert_allclose(shifts.std(axis=0), least_deviations(transmission.fisher(lengths)), rtol=0.015)


@pytest.mark.parametrize(
    "information", [np.zeros((2, 2)), np.ones((2, 2)), np.diag([1.0, 0.0]), np.outer([1.0, 2.0, 3.0], [1.0, 2.0, 3.0])]
)
def test_what_cannot_be_told_apart_is_unbounded(information):
    assert np.isinf(least_deviations(information)).all()
