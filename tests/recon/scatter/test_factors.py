"""Factors of scatter where slopes are known functions."""

import numpy as np
import pytest

from recon.scatter.factors import ENOUGH, LARGEST, factor_between, factors_near


@pytest.mark.parametrize("wanted", [0.0, 0.14, 1.0, 3.7, 15.0])
def test_a_zero_is_found_between_bounds(wanted):
    found = factor_between(lambda factor: wanted / (factor + 0.1) - factor / (factor + 0.1))
    assert found == pytest.approx(wanted, abs=2 * ENOUGH)


@pytest.mark.parametrize(("sign", "bound"), [(-1.0, 0.0), (1.0, LARGEST)])
def test_slopes_of_one_sign_end_at_a_bound(sign, bound):
    assert factor_between(lambda factor: sign) == bound


@pytest.mark.parametrize("count", [1, 2, 5])
def test_zeros_of_coupled_slopes_are_found_nearby(count):
    random = np.random.default_rng(count)
    root = random.normal(size=(count, count))
    curvature = root @ root.T + np.eye(count)
    wanted = random.uniform(0.5, 1.5, count)

    def slopes(factors):
        away = factors - wanted
        return -curvature @ away / (1 + 0.1 * factors.mean())

    assert factors_near(slopes, np.ones(count)) == pytest.approx(wanted, abs=ENOUGH)


def test_factors_do_not_become_negative():
    assert factors_near(lambda factors: -(factors + 0.2), np.array([0.3])) == [0.0]
