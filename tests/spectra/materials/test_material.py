import numpy as np
import pytest

from spectra.basis.basis import Basis, BasisFunction
from spectra.errors import InputError
from spectra.materials.material import Material

ENERGY = np.linspace(20.0, 140.0, 481)
FLAT = np.ones_like(ENERGY)
TWO = Basis((BasisFunction("photoelectric"), BasisFunction("compton")))


def test_water_has_the_coefficients_of_the_literature():
    water = Material("water", composition="Water, Liquid")
    # Relative least squares of mu/rho over 20 to 140 keV in cm^2/g at density 1, hence 1/cm; files use 1/mm.
    np.testing.assert_allclose(water.coefficients_in(TWO, ENERGY, FLAT), [0.00138, 0.01788], rtol=5e-3)
    assert 1e-3 < water.fit_error(TWO, ENERGY, FLAT) < 2.5e-3


def test_an_element_column_takes_a_contrast_agent_exactly():
    basis = Basis((*TWO.functions, BasisFunction("element", element="Lu")))
    solution = Material("solution", density=1.02, composition={"H": 0.1097, "O": 0.8703, "Lu": 0.02})
    water = Material("water", density=1.02, composition={"H": 0.1119, "O": 0.8881})
    found = solution.coefficients_in(basis, ENERGY, FLAT)
    np.testing.assert_allclose(found[:2], 0.98 * water.coefficients_in(TWO, ENERGY, FLAT), rtol=2e-2)
    assert solution.fit_error(basis, ENERGY, FLAT) < 2.5e-3
    assert solution.fit_error(TWO, ENERGY, FLAT) > 0.05


def test_an_element_column_holds_the_amount_of_the_element_and_nothing_else():
    basis = Basis((*TWO.functions, *(BasisFunction("element", element=e) for e in ("I", "Gd"))))
    water = Material("water", composition="Water, Liquid")
    np.testing.assert_array_equal(
        water.coefficients_in(basis, ENERGY, FLAT), [*water.coefficients_in(TWO, ENERGY, FLAT), 0, 0]
    )
    mixed = Material("mixed", 1.01, {"H": 0.1108, "O": 0.8792, "I": 0.01})
    found = mixed.coefficients_in(basis, ENERGY, FLAT)
    # mu/rho of iodine at 70.01 keV: NIST SRD 126 prints 7.579 at 60 and 3.510 cm^2/g at 80 keV, a straight line in log.
    slope = np.log(3.510 / 7.579) / np.log(80 / 60)
    assert found[2] == pytest.approx(0.1 * 1.01 * 0.01 * 7.579 * (70.01 / 60) ** slope, rel=2e-3)
    assert found[3] == 0
    iodine = Material("iodine", composition="I").coefficients_in(basis, ENERGY, FLAT)
    np.testing.assert_allclose(iodine[[0, 1, 3]], 0, atol=1e-12)


def test_a_step_is_for_materials_with_an_edge_nearby():
    basis = Basis((*TWO.functions, BasisFunction("step", edge_energy=63.3)))
    assert Material("bone", composition="cortical bone").coefficients_in(basis, ENERGY, FLAT)[2] == 0
    lutetium = Material("solution", 1.02, {"H": 0.1097, "O": 0.8703, "Lu": 0.02})
    assert lutetium.coefficients_in(basis, ENERGY, FLAT)[2] > 0.01


def test_fitted_coefficients_are_never_negative():
    basis = Basis((*TWO.functions, BasisFunction("step", edge_energy=63.3)))
    assert (Material("bone", composition="Bone, Cortical (ICRP)").coefficients_in(basis, ENERGY, FLAT) >= 0).all()


def test_explicit_coefficients_are_their_own_truth(basis):
    tissue = Material("tissue", coefficients={"photoelectric": 0.0015, "compton": 0.0188})
    np.testing.assert_array_equal(tissue.coefficients_in(basis, ENERGY, FLAT), [0.0015, 0.0188, 0.0])
    expected = 0.0015 * (ENERGY / 70) ** -3 + 0.0188 * basis.functions[1].evaluate(ENERGY)
    np.testing.assert_allclose(tissue.attenuation(ENERGY, basis), expected, rtol=1e-13)
    assert tissue.fit_error(basis, ENERGY, FLAT) == 0
    assert tissue.k_edges(20, 140) == ()


def test_known_densities_need_not_be_given():
    assert Material("sensor", composition="CdTe").density == 5.85
    assert Material("iron", composition="Fe").density == pytest.approx(7.874)
    assert Material("water", composition="Water, Liquid").density == 1.0


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Material("x"), "either a composition or coefficients"),
        (lambda: Material("x", composition="H2O", coefficients={}), "either"),
        (lambda: Material("x", composition="H2O"), "needs a density"),
        (lambda: Material("x", density=-1.0, composition="H2O"), "density"),
        (lambda: Material("x", density=float("nan"), composition="H2O"), "density"),
        (lambda: Material("x", coefficients={"compton": -0.1}), "not negative"),
        (lambda: Material("x", coefficients={"kedge_63.3": 0.1}).attenuation(ENERGY, TWO), "not in the basis"),
        (lambda: Material("x", coefficients={"compton": 0.1}).attenuation(ENERGY), "needs a basis"),
    ],
)
def test_impossible_materials_are_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()
