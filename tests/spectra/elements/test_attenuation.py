import numpy as np
import pytest

from spectra.elements.attenuation import (
    atomic_number,
    edge_energy,
    k_edges,
    linear_attenuation,
    mass_attenuation,
    mass_fractions,
)
from spectra.errors import InputError

# NIST SRD 126 (Hubbell & Seltzer), mu/rho with coherent scattering [cm^2/g].
NIST = {
    "Water, Liquid": {20: 8.096e-1, 60: 2.059e-1, 100: 1.707e-1, 150: 1.505e-1},
    "Al": {20: 3.441, 60: 2.778e-1, 100: 1.704e-1, 150: 1.378e-1},
    "W": {60: 3.713, 100: 4.438, 150: 1.581},
}


@pytest.mark.parametrize("name", NIST)
def test_mass_attenuation_agrees_with_nist(name):
    energies = np.array(list(NIST[name]), dtype=float)
    np.testing.assert_allclose(mass_attenuation(name, energies), list(NIST[name].values()), rtol=1e-3)


@pytest.mark.parametrize("element", ["I", "Gd", "Lu", "W", "Au"])
def test_an_edge_belongs_to_its_upper_branch_whatever_the_table_does(element):
    edge = edge_energy(element)
    around = mass_attenuation(element, edge + np.array([-0.02, -1e-6, 0.0, 1e-6, 0.02]))
    np.testing.assert_allclose(around[:2], around[0], rtol=2e-3)
    np.testing.assert_allclose(around[2:], around[4], rtol=2e-3)
    assert around[2] > 4 * around[1]


def test_mass_fractions_weigh_the_elements():
    energy = np.array([30.0, 70.0])
    water = {"H": 0.111894, "O": 0.888106}
    by_hand = sum(part * mass_attenuation(element, energy) for element, part in water.items())
    np.testing.assert_allclose(mass_attenuation(water, energy), by_hand, rtol=1e-12)
    np.testing.assert_allclose(mass_attenuation(" H2O ", energy), by_hand, rtol=1e-3)
    assert sum(part for _, part in mass_fractions({"H": 0.1118, "O": 0.8885})) == pytest.approx(1, abs=1e-15)


@pytest.mark.parametrize("count", [100, 20_000])
def test_what_is_kept_does_not_change_under_the_hands_of_callers(count):
    energies = np.linspace(20, 120, count)
    first = mass_attenuation("I", energies)
    expected = first.copy()
    first[:] = 0.0
    np.testing.assert_array_equal(mass_attenuation("I", energies), expected)
    np.testing.assert_array_equal(mass_attenuation("I", energies[:50]), expected[:50])


def test_linear_attenuation_is_in_per_mm():
    np.testing.assert_allclose(linear_attenuation("H2O", 1.0, np.array([60.0])), 0.02059, rtol=1e-3)


def test_k_edges_of_a_sensor():
    np.testing.assert_allclose(k_edges("CdTe", 20, 140), [26.711, 31.814], atol=1e-3)


def test_a_detector_alloy_is_not_mistaken_for_mass_fractions():
    assert len(mass_fractions("Cd0.9Zn0.1Te")) == 3


@pytest.mark.parametrize(
    ("composition", "words"),
    [
        ("CsI(Tl)", "bracket"),
        ("CaSO4.2H2O", "hydrate"),
        ("H0.1119O0.8881", "mass fractions"),
        ("CaSO42.5H2O", "hydrate"),
        ("H11.19O88.81", "hydrate"),
        ("CO", "'CO' may mean Co or C and O: write 'Co' or 'C1O1'"),
        ("SN", "write 'Sn' or 'S1N1'"),
        ("SIO2", "write 'SiO2' or 'S1IO2'"),
        ("CSI", "may mean Cs"),
        ("PBO", "may mean Pb"),
        ("H\u2082O", "plain ASCII"),
        ("h2o", "unknown material"),
        ("D2O", "unknown material"),
        ("2H2O", "unknown material"),
        ("Gd2O2S:Tb", "unknown material"),
        ("(H2O", "unknown material"),
        ("H2 O", "unknown material"),
        ("Water", "did you mean 'water'"),
        ("Adamantium", "unknown material"),
        ("", "unknown material"),
        ({}, "at least one element"),
        ({"H": 0.5, "O": 0.4}, "sum to 0.9"),
        ({"Xx": 1.0}, "unknown element 'Xx'"),
        ({"H": 1.5, "O": -0.5}, "between 0 and 1"),
        ({"Es": 1.0}, "H to Cf"),
    ],
)
def test_compositions_that_would_be_misread_are_refused(composition, words):
    with pytest.raises(InputError, match=words):
        mass_fractions(composition)


@pytest.mark.parametrize(
    ("formula", "numbers"),
    [
        ("C1O1", [6, 8]),
        ("Co", [27]),
        ("CO2", [6, 8]),
        ("C2HF5", [1, 6, 9]),
        ("CuSO4(H2O)5", [1, 8, 16, 29]),
        ("CS2", [6, 16]),
        ("KNO3", [7, 8, 19]),
        ("C6H12O6", [1, 6, 8]),
        ("Gd2O2S", [8, 16, 64]),
        ("BN", [5, 7]),
    ],
)
def test_formulas_that_mean_what_they_say_are_taken(formula, numbers):
    assert [number for number, _ in mass_fractions(formula)] == numbers


@pytest.mark.parametrize("energy", [0.5, 801.0, np.nan, -3.0])
def test_energies_without_data_are_refused(energy):
    with pytest.raises(InputError, match="1 to 800 keV"):
        mass_attenuation("H2O", np.array([60.0, energy]))


def test_atomic_number_wants_a_symbol():
    assert atomic_number("Lu") == 71
    with pytest.raises(InputError, match="give its symbol"):
        atomic_number("adamantium")
    with pytest.raises(InputError, match="unknown element 'Lutetium': did you mean 'Lu'"):
        atomic_number("Lutetium")
