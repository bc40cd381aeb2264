"""Physical numbers from coefficients against compositions of tables and closed forms."""

import numpy as np
import pytest

from recon.readouts.quantity import NAMES, attenuation_of_water, in_pieces, quantity
from recon.readouts.readouts import WATER, Readouts, tabulated_water
from spectra.basis.basis import Basis, BasisFunction
from spectra.elements.attenuation import electrons_per_gram
from spectra.errors import InputError
from spectra.materials.material import Material

ENERGY, WEIGHTS = np.linspace(20.0, 140.0, 121), np.ones(121)
PE, COMPTON = BasisFunction("photoelectric"), BasisFunction("compton")
DUAL = Basis((PE, COMPTON))
CONTRAST = Basis((PE, COMPTON, *(BasisFunction("element", element=e) for e in ("I", "Gd", "Au"))))
BLOOD = {"H": 0.111, "O": 0.879, "I": 0.01}
MATERIALS = Basis(
    (
        BasisFunction("material", composition="Water, Liquid"),
        BasisFunction("material", composition="cortical bone"),
        BasisFunction("material", composition=BLOOD, name="iodinated"),
    )
)
TISSUES = ("Water, Liquid", "Adipose Tissue (ICRP)", "muscle", "cortical bone", "PMMA", "Polyethylene", "Al")


def readouts(basis):
    return Readouts.of(basis, ENERGY, WEIGHTS)


def coefficients(material, basis):
    return material.coefficients_in(basis, ENERGY, WEIGHTS)


def solution(element, amount):
    """Water with an element [mg/ml]; all of the water stays."""
    total = 1.0 + amount / 1000
    return Material("vial", total, {"H": 0.111894 / total, "O": 0.888106 / total, element: amount / 1000 / total})


@pytest.mark.parametrize("name", TISSUES)
def test_electron_densities_are_those_of_tables(name):
    material = Material(name, composition=name)
    true = material.density * electrons_per_gram(name) / electrons_per_gram("Water, Liquid")
    found = float(readouts(DUAL).electron_density(coefficients(material, DUAL)))
    assert found == pytest.approx(true, rel=0.002)


@pytest.mark.parametrize("number", [6, 8, 13, 20])
def test_the_effective_atomic_number_of_an_element_is_its_own(number):
    symbol = {6: "C", 8: "O", 13: "Al", 20: "Ca"}[number]
    values = coefficients(Material(symbol, 1.3, {symbol: 1.0}), DUAL)
    assert float(readouts(DUAL).effective_atomic_number(values)) == pytest.approx(number, abs=1e-6)


@pytest.mark.parametrize("energy", [40.0, 70.0, 100.0, 140.0])
@pytest.mark.parametrize("name", ["Water, Liquid", "muscle", "cortical bone"])
def test_monoenergetic_images_are_attenuation_of_tables(name, energy):
    material = Material(name, composition=name)
    exact = material.attenuation(np.array([energy]))[0]
    found = quantity(readouts(DUAL), "vmi", energy).values(coefficients(material, DUAL))
    assert float(found) == pytest.approx(exact, rel=0.003)


@pytest.mark.parametrize(("element", "word"), [("I", "iodine"), ("Gd", "gadolinium"), ("Au", "gold")])
@pytest.mark.parametrize("amount", [0.5, 5.0, 50.0])
def test_concentrations_of_solutions_are_found(element, word, amount):
    values = coefficients(solution(element, amount), CONTRAST)
    conversion = readouts(CONTRAST)
    chosen = quantity(conversion, word)
    assert (chosen.unit, chosen.name) == ("mg/ml", f"concentration_{element}")
    assert float(chosen.values(values)) == pytest.approx(amount, rel=1e-9)
    assert float(quantity(conversion, element).values(values)) == pytest.approx(amount, rel=1e-9)
    assert float(quantity(conversion, "vnc", 70.0).values(values)) == pytest.approx(0.0, abs=0.3)
    assert float(quantity(conversion, "electron-density").values(values)) == pytest.approx(1.0, abs=0.02)
    others = {"I", "Gd", "Au"} - {element}
    assert all(abs(float(conversion.concentration(values, other))) < 1e-12 for other in others)


def test_a_material_with_iodine_as_basis_function_shows_its_iodine():
    conversion = readouts(MATERIALS)
    amounts = np.array([0.3, 0.1, 0.5])  # of water, bone and iodinated water, at their density of 1 g/ml
    densities = amounts * np.array([1.0, 1.85, 1.0])
    values = np.array(
        [
            Material("m", rho, dict(f.amounts)).attenuation(np.array([70.0]))[0]
            for rho, f in zip(densities, MATERIALS.functions, strict=True)
        ]
    )
    assert float(conversion.concentration(values, "I")) == pytest.approx(1000 * 0.01 * densities[2], rel=1e-9)
    plain = conversion.without_contrast(values)
    assert float(conversion.concentration(plain, "I")) == pytest.approx(0.0, abs=1e-4)
    expected = coefficients(
        Material("without", 0.99 * densities[2], {"H": 0.111 / 0.99, "O": 0.879 / 0.99}), MATERIALS
    ) + np.array([values[0], values[1], 0.0])
    at = np.array([70.0])
    found = MATERIALS.evaluate(at)[:, 0] @ plain
    assert found == pytest.approx(MATERIALS.evaluate(at)[:, 0] @ expected, rel=2e-3)


@pytest.mark.parametrize("energy", [40.0, 70.0, 120.0])
def test_water_is_what_the_user_says(energy):
    conversion, water = readouts(DUAL), coefficients(WATER, DUAL)
    mu = float(conversion.attenuation(water, energy))
    assert float(quantity(conversion, "hu", energy).values(water)) == pytest.approx(0.0, abs=1e-9)
    table = float(quantity(conversion, "hu", energy, "table").values(water))
    assert table == pytest.approx(1000 * (mu / tabulated_water(energy) - 1))
    assert float(quantity(conversion, "hu", energy, "0.02").values(water)) == pytest.approx(1000 * (mu / 0.02 - 1))
    assert tabulated_water(60.0) == pytest.approx(0.02059, rel=2e-3)  # NIST: 0.2059 cm^2/g at 60 keV


@pytest.mark.parametrize("water", ["ice", "0", "-1", "nan", "inf"])
def test_impossible_water_is_refused(water):
    with pytest.raises(InputError, match="--water must be one of basis, table, or the attenuation of water at 70 keV"):
        attenuation_of_water(70.0, water)


@pytest.mark.parametrize("energy", [float("nan"), 0.0, -3.0, 9.0, 501.0, float("inf")])
def test_impossible_energies_are_refused(energy):
    with pytest.raises(InputError, match="--energy must be between 10 and 500 keV"):
        quantity(readouts(DUAL), "hu", energy)


def test_an_energy_outside_of_the_spectrum_is_called_an_extrapolation():
    conversion = readouts(DUAL)
    assert quantity(conversion, "hu", 140.0).caution is None
    for energy in (500.0, 141.0, 19.0):
        assert "outside of the detected spectrum (nodes at 20 to 140 keV)" in str(
            quantity(conversion, "hu", energy).caution
        )


@pytest.mark.parametrize(
    ("basis", "name", "words"),
    [
        (DUAL, "iodine", "none of its functions shows one"),
        (CONTRAST, "Bi", "its functions show I, Gd, Au"),
        (DUAL, "vnc", "needs a basis function of a contrast agent"),
        (DUAL, "colour", "there is no quantity 'colour': choose from vmi, hu, vnc"),
        (Basis((COMPTON,)), "zeff", "zeff needs two basis functions"),
        (Basis((COMPTON,)), "electron-density", "electron-density needs two basis functions"),
    ],
)
def test_what_a_basis_cannot_show_is_refused(basis, name, words):
    with pytest.raises(InputError, match=words):
        quantity(readouts(basis), name)


def test_options_without_meaning_are_refused():
    with pytest.raises(InputError, match="--energy is for images at one energy"):
        quantity(readouts(DUAL), "zeff", 70.0)
    with pytest.raises(InputError, match="--water is for CT numbers"):
        quantity(readouts(DUAL), "vmi", 70.0, "table")


@pytest.mark.parametrize("name", [*NAMES, "gold"])
def test_pieces_give_the_same_as_the_whole(name):
    values = np.random.default_rng(1).uniform(0, 0.02, (5, 4, 3, 2))
    chosen = quantity(readouts(CONTRAST), name)
    np.testing.assert_allclose(in_pieces(chosen, values, 7), chosen.values(values), rtol=1e-6)
