"""Interpolation between energies: polynomials in log energy are exact, intervals know nothing of each other."""

import numpy as np
import pytest

from spectra.elements.attenuation import linear_attenuation
from spectra.energy.chebyshev import PiecewiseChebyshev
from spectra.errors import InputError

TWO = PiecewiseChebyshev((20.0, 50.0, 160.0), (5, 3))


def test_polynomials_in_log_energy_are_exact_also_at_bounds_and_nodes():
    energy = np.concatenate([np.geomspace(20, 160, 77), TWO.nodes])
    for powers, inside in (((1, -2, 3, 0.5, 0.25), energy < 50), ((2, 1, -3), energy >= 50)):
        found = TWO.matrix(energy[inside]) @ np.polynomial.Polynomial(powers)(np.log(TWO.nodes))
        wanted = np.polynomial.Polynomial(powers)(np.log(energy[inside]))
        np.testing.assert_allclose(found, wanted, rtol=1e-11)


def test_rows_sum_to_one_and_see_their_own_interval_only():
    matrix = TWO.matrix(np.array([20.0, 49.999, 50.0, 160.0]))
    np.testing.assert_allclose(matrix.sum(axis=1), 1.0, rtol=1e-12)
    assert not matrix[:2, 5:].any()
    assert not matrix[2:, :5].any()


def test_attenuation_beside_an_edge_needs_few_nodes():
    edge = 50.2391  # of gadolinium
    energy = np.geomspace(20, 160, 400)
    steps = PiecewiseChebyshev((20.0, edge, 160.0), (10, 10))
    curves = [linear_attenuation("Gd2O3", 7.4, e) for e in (steps.nodes, energy)]
    np.testing.assert_allclose(steps.matrix(energy) @ curves[0], curves[1], rtol=5e-4)


@pytest.mark.parametrize("energy", [19.9, 160.1])
def test_energies_outside_are_refused(energy):
    with pytest.raises(InputError, match=r"is not within 20 \.\. 160 keV"):
        TWO.matrix(np.array([energy]))


@pytest.mark.parametrize(("bounds", "counts"), [((20.0,), ()), ((50.0, 20.0), (3,)), ((20.0, 50.0), (0,))])
def test_impossible_intervals_are_refused(bounds, counts):
    with pytest.raises(InputError, match="do not make an interpolation"):
        PiecewiseChebyshev(bounds, counts)
