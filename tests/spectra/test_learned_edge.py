"""Edges that are learned: gradients, their limits, and an edge that is found again."""

from itertools import pairwise

import numpy as np
import pytest
import torch

from spectra.basis.basis import Basis, BasisFunction
from spectra.differentiable import transmit
from spectra.errors import InputError
from spectra.learned_edge import edge_column, steepest_width, transmit_with_edges
from spectra.transmission import Transmission

ENERGY = np.linspace(21.0, 119.0, 99)
THRESHOLDS = (20, 45, 63, 80, 120)


def model_with(edge, width, kind="step", energy=ENERGY):
    third = BasisFunction(kind, edge_energy=edge, edge_width=width)
    basis = Basis((BasisFunction("photoelectric"), BasisFunction("compton"), third))
    spectrum = 1e4 * np.exp(-(((energy - 60) / 25) ** 2)) * np.gradient(energy)
    inside = [(energy >= low) & (energy < high) for low, high in pairwise(THRESHOLDS)]
    return Transmission.from_spectrum(np.array(inside) * spectrum, basis.evaluate(energy))


def rays(seed, count):
    return torch.tensor(np.random.default_rng(seed).random((count, 3)) * [0.3, 2.0, 1.0])


def column(edge, width, kind="step", energy=ENERGY):
    return edge_column(torch.tensor(energy), edge, width, 70.0 if kind == "step" else None)


@pytest.mark.parametrize("kind", ["step", "sigmoid"])
def test_columns_and_counts_are_those_of_the_basis(kind):
    model, lengths = model_with(63.3, 2.0, kind), rays(0, 6)
    learned = column(torch.tensor(63.3), torch.tensor(2.0), kind)
    np.testing.assert_allclose(learned, model.columns[2], rtol=1e-6)
    exact = column(torch.tensor(63.3, dtype=torch.float64), torch.tensor(2.0, dtype=torch.float64), kind)
    counts = transmit_with_edges(lengths, model, [(2, exact)])
    np.testing.assert_allclose(counts, transmit(lengths, model), rtol=1e-12)


@pytest.mark.parametrize("kind", ["step", "sigmoid"])
@pytest.mark.parametrize(("edge", "width"), [(63.3, 2.0), (50.24, 0.7), (30.0, 5.0)])
def test_gradients_in_lengths_edge_and_width(kind, edge, width):
    model, lengths = model_with(edge, width, kind), rays(1, 2).requires_grad_()
    values = [torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in (edge, width)]

    def counts(lengths, edge, width):
        return transmit_with_edges(lengths, model, [(2, column(edge, width, kind))])

    assert torch.autograd.gradcheck(counts, (lengths, *values), eps=1e-5)


def variation(gamma, step=1.875):
    """Largest over smallest gradient of counts in E_K while the edge moves through one step of the grid."""
    energy = np.arange(20.9375, 120, step)
    model, lengths = model_with(60.0, 1 / gamma, "sigmoid", energy), torch.tensor([[0.1, 1.0, 0.5]]).double()
    slopes = []
    for shift in np.linspace(0, step, 9):
        edge = torch.tensor(energy[20] + shift, requires_grad=True)
        learned = column(edge, torch.tensor(1 / gamma), "sigmoid", energy)
        transmit_with_edges(lengths, model, [(2, learned)]).sum().backward()
        slopes.append(edge.grad.item())
    return max(slopes) / min(slopes)


def test_gradients_die_between_nodes_when_the_edge_is_steep():
    """The limit that the documentation states, gamma dE <~ 2: a smooth slope below, a staircase above."""
    assert variation(1.0) < 1.2
    assert variation(2.0) < 2
    assert variation(5.0) > 8
    assert variation(10.0) > 500


def test_steepest_width_is_half_the_distance_of_the_nodes():
    energy = torch.tensor([20.0, 40.0, 41.0, 80.0])
    assert steepest_width(energy, 40.4) == pytest.approx(0.5)
    assert steepest_width(energy, 60.0) == pytest.approx(19.5)
    assert steepest_width(energy, 90.0) == float("inf")


def test_an_edge_is_found_again_from_counts():
    lengths = rays(2, 200)
    measured = transmit_with_edges(lengths, model_with(63.3, 1.0), [])
    model = model_with(60.0, 2.0)
    edge, width = (torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in (60.0, 2.0))
    optimiser = torch.optim.LBFGS([edge, width], max_iter=60, line_search_fn="strong_wolfe")

    def loss():
        optimiser.zero_grad()
        expected = transmit_with_edges(lengths, model, [(2, column(edge, width))])
        value = (expected - measured * (expected / measured).log() - measured).sum() / measured.sum()
        value.backward()
        return value

    optimiser.step(loss)
    assert edge.item() == pytest.approx(63.3, abs=0.01)
    assert width.item() == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: column(torch.tensor(60.0), torch.tensor(0.0)), "must be positive, got 0 keV"),
        (lambda: transmit_with_edges(rays(0, 1), model_with(60.0, 1.0), [(3, torch.zeros(99))]), "column 3 of shape"),
        (lambda: transmit_with_edges(rays(0, 1), model_with(60.0, 1.0), [(2, torch.zeros(5))]), "does not fit 3"),
    ],
)
def test_what_does_not_fit_is_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()
