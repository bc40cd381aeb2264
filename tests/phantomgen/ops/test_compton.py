"""Single scatter in numba against its formula, and the sum over all directions against the total cross section."""

import numpy as np
import pytest

from phantomgen.ops.compton import reference, scattered_to
from phantomgen.ops.compton.inputs import Energies, Points
from spectra.basis.basis import klein_nishina
from spectra.materials.electron_density import ELECTRON_RADIUS

STEP = 0.5


def energies(edges: np.ndarray, materials: int, groups: int) -> Energies:
    rng = np.random.default_rng(4)
    table = np.arange(0, edges[-1] + 2 * STEP, STEP)
    measured = np.cumsum(rng.random((len(table), groups)), axis=0)
    return Energies(edges, STEP, rng.random((len(table), materials)) / 50, measured)


@pytest.mark.parametrize(("points", "materials", "groups"), [(1, 1, 1), (40, 3, 4), (0, 2, 2)])
def test_the_kernel_is_the_formula(points, materials, groups):
    rng = np.random.default_rng(points)
    edges = np.array([30.0, 45.0, 61.2, 61.2001, 90.0, 120.0])
    where = Points(rng.uniform(-30, 30, (points, 3)), rng.random(points), rng.random((points, 5)))
    lengths = rng.uniform(0, 40, (points, materials))
    args = np.array([-300.0, 20, 30]), np.array([1.0, 0.1, 0]), np.array([500.0, 0, 0]), where, lengths
    table = energies(edges, materials, groups)
    np.testing.assert_allclose(scattered_to(*args, table), reference.scattered_to(*args, table), rtol=1e-9)


@pytest.mark.parametrize("energy", [20.0, 70.0, 140.0, 511.0])
def test_what_one_electron_scatters_in_all_directions_is_the_total_cross_section(energy):
    """Pixels all around an electron, on a Gauss grid of cosines, count every photon."""
    cosine, weight = np.polynomial.legendre.leggauss(40)
    edges = np.array([energy, energy + 1e-6])
    table = np.arange(0, energy + 2 * STEP, STEP)
    all_of_it = Energies(edges, STEP, np.zeros((len(table), 1)), table[:, None])
    electron = Points(np.zeros((1, 3)), np.full(1, ELECTRON_RADIUS**2 / 2), np.ones((1, 1)))
    source, radius = np.array([0.0, 0, -500.0]), 200.0
    total = 0.0
    for c, w in zip(cosine, weight, strict=True):
        normal = np.array([np.sqrt(1 - c**2), 0, c])
        area = 2 * np.pi * w * radius**2 * normal
        total += scattered_to(radius * normal, area, source, electron, np.zeros((1, 1)), all_of_it)[0]
    wanted = 2 * np.pi * ELECTRON_RADIUS**2 * klein_nishina(np.array([energy]))[0] / 500.0**2
    assert total == pytest.approx(wanted, rel=1e-6)
