"""Mixtures and solutions against the closed forms of mixing."""

import numpy as np
import pytest

from spectra.elements.attenuation import linear_attenuation, mass_fractions
from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.materials.mixing import Part, dissolve, mix_by_mass, mix_by_volume

ENERGY = np.array([20.0, 33.0, 34.0, 60.0, 120.0])
WATER, BONE = Material("w", composition="Water, Liquid"), Material("b", composition="cortical bone")


def parts(**amounts):
    return [Part.of({"w": WATER, "b": BONE}[name], amount) for name, amount in amounts.items()]


def test_attenuation_mixes_by_volume():
    mixed = mix_by_volume("m", parts(w=0.7, b=0.3))
    assert mixed.density == pytest.approx(0.7 * 1.0 + 0.3 * 1.92, rel=1e-14)
    expected = 0.7 * WATER.attenuation(ENERGY) + 0.3 * BONE.attenuation(ENERGY)
    np.testing.assert_allclose(mixed.attenuation(ENERGY), expected, rtol=1e-13)


def test_mass_attenuation_mixes_by_mass():
    mixed = mix_by_mass("m", parts(w=0.7, b=0.3))
    assert mixed.density == pytest.approx(1 / (0.7 / 1.0 + 0.3 / 1.92), rel=1e-14)
    by_mass = 0.7 * WATER.attenuation(ENERGY) / 1.0 + 0.3 * BONE.attenuation(ENERGY) / 1.92
    np.testing.assert_allclose(mixed.attenuation(ENERGY) / mixed.density, by_mass, rtol=1e-13)


def test_both_ways_to_say_it_agree():
    by_volume = mix_by_volume("m", parts(w=0.7, b=0.3))
    by_mass = mix_by_mass("m", parts(w=0.7 / by_volume.density, b=0.3 * 1.92 / by_volume.density))
    assert by_mass.density == pytest.approx(by_volume.density, rel=1e-13)
    assert by_mass.composition == pytest.approx(by_volume.composition, rel=1e-12)


@pytest.mark.parametrize(("element", "density"), [("I", 4.93), ("Gd", 7.9004), ("Au", 19.32), ("Bi", 9.747)])
@pytest.mark.parametrize("concentration", [0.0, 0.5, 10.0, 300.0])
def test_a_solution_holds_its_concentration_and_displaces_water(element, density, concentration):
    solution = dissolve("s", Part.of(WATER, 0), [Part.of(element, concentration)])
    grams = concentration / 1000
    assert solution.density == pytest.approx(grams + 1 - grams / density, rel=1e-12)
    assert (solution.composition or {}).get(element, 0) * solution.density == pytest.approx(grams, rel=1e-12)
    expected = (1 - grams / density) * WATER.attenuation(ENERGY) + linear_attenuation(element, grams or 1, ENERGY) * (
        grams > 0
    )
    np.testing.assert_allclose(solution.attenuation(ENERGY), expected, rtol=1e-12)


def test_ten_mg_per_ml_of_iodine_adds_what_nist_prints():
    # NIST SRD 126: iodine 7.579 cm^2/g at 60 keV, water 0.2059 cm^2/g.
    mu = dissolve("s", Part.of("Water, Liquid", 0), [Part.of("I", 10)]).attenuation(np.array([60.0]))[0]
    assert mu == pytest.approx(0.1 * (0.2059 * (1 - 0.01 / 4.93) + 0.01 * 7.579), rel=1e-3)


def test_solutes_may_be_compounds_and_several():
    agents = [Part.of("hydroxyapatite", 200), Part.of("I", 5)]
    solution = dissolve("s", Part.of("blood", 0), agents)
    assert solution.density == pytest.approx(0.205 + (1 - 0.2 / 3.16 - 0.005 / 4.93) * 1.06, rel=1e-3)
    assert solution.composition["Ca"] == pytest.approx(0.2 * 0.39895 / solution.density, rel=1e-3)


def test_a_measured_density_is_kept_and_needs_no_other():
    solution = dissolve("s", Part.of(WATER, 0), [Part.of("GdCl3", 20)], density=1.015)
    gadolinium = dict(mass_fractions("GdCl3"))[64]
    assert solution.density == 1.015
    assert solution.composition["Gd"] * 1.015 == pytest.approx(0.020 * gadolinium, rel=1e-12)
    plastic = mix_by_mass("p", [Part.of("C5H8O2", 0.9), Part.of("BaSO4", 0.1)], density=1.3)
    assert plastic.density == 1.3
    assert mix_by_volume("m", parts(w=0.5, b=0.5), density=1.5).density == 1.5


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: mix_by_mass("m", parts(w=0.7, b=0.2)), "the mass fractions of 'm' must sum to 1, they sum to 0.9"),
        (lambda: mix_by_volume("m", parts(w=1.7, b=-0.7)), "must lie between 0 and 1"),
        (lambda: mix_by_volume("m", parts(w=float("nan"))), "must lie between 0 and 1"),
        (lambda: mix_by_mass("m", []), "must lie between"),
        (lambda: mix_by_mass("m", [Part.of("BaSO4", 1.0)]), "'BaSO4' needs a density to be mixed"),
        (lambda: dissolve("s", Part.of("C8H18", 0), [Part.of("I", 1)]), "'C8H18' needs a density"),
        (lambda: dissolve("s", Part.of(WATER, 0), [Part.of("I", -1)]), "finite and not negative"),
        (lambda: dissolve("s", Part.of(WATER, 0), [Part.of("I", 5000)]), "would fill 1.01 times its volume"),
        (lambda: dissolve("s", Part.of(WATER, 0), [Part.of("Xe", 10)]), "would fill 1.8"),
        (lambda: dissolve("s", Part.of(WATER, 0), [Part.of("I", 1100)], 1.05), "weigh more than its density"),
        (lambda: Part.of(Material("c", coefficients={"compton": 0.02}), 1.0), "only compositions can be mixed"),
        (lambda: Part.of("Watr", 1.0), "unknown material 'Watr'; did you mean 'water'"),
    ],
)
def test_impossible_mixtures_are_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()
