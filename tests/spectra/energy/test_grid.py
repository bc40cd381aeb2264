import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spectra.energy.grid import Energies
from spectra.errors import InputError

CUTS = st.lists(st.floats(15, 145), max_size=6)


@given(breaks=CUTS, lines=CUTS, count=st.integers(1, 200))
def test_snapped_grids_keep_every_break_and_isolate_every_line(breaks, lines, count):
    grid = Energies.snapped(20, 140, count, breaks, lines)
    edges = grid.edges
    assert edges[0] == 20
    assert edges[-1] == 140
    for value in breaks:
        assert not 20 < value < 140 or np.abs(edges - value).min() < 1e-5
    for line in {line for line in lines if 20 <= line <= 140}:
        own = np.searchsorted(edges, line, side="right") - 1
        assert grid.widths[min(own, len(grid) - 1)] <= 0.0201


@given(breaks=CUTS, lines=st.lists(st.sampled_from([57.98, 59.32, 63.3, 67.24, 69.1]), unique=True, max_size=5))
def test_gauss_legendre_is_exact_for_polynomials(breaks, lines):
    grid = Energies.gauss_legendre(20, 140, 4, breaks, lines)
    # A line's bin has its node at the line, not at a Gauss node: exact to its width squared only.
    tolerance = 1e-9 if not lines else 1e-4
    for power in range(8):
        exact = (140.0 ** (power + 1) - 20.0 ** (power + 1)) / (power + 1)
        assert np.sum(grid.widths * grid.nodes**power) == pytest.approx(exact, rel=tolerance)


def test_midpoint_reproduces_the_plain_rule():
    grid = Energies.midpoint(20, 140, 64)
    assert len(grid) == 64
    np.testing.assert_allclose(grid.nodes, 20 + 1.875 * (np.arange(64) + 0.5))


def test_single_has_one_energy():
    grid = Energies.single(60)
    assert len(grid) == 1
    assert grid.nodes[0] == 60


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Energies.from_edges(np.array([20.0, 30.0, 30.0])), "edge 2 is 30 keV after 30 keV"),
        (lambda: Energies.from_edges(np.array([20.0])), "two finite edges"),
        (lambda: Energies(np.array([20.0, 30.0]), np.array([31.0])), "lie in its bin"),
        (lambda: Energies(np.array([20.0, 30.0]), np.array([21.0, 22.0])), "as many nodes"),
        (lambda: Energies.snapped(140, 20, 10), "must ascend"),
        (lambda: Energies.midpoint(20, 140, 0), "at least one bin"),
    ],
)
def test_impossible_grids_are_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()
