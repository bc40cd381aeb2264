import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spectra.basis.basis import Basis, BasisFunction
from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.materials.material_curve import ENERGY, MaterialCurve

BASIS = Basis((BasisFunction("photoelectric"), BasisFunction("compton")))
ENERGIES = np.linspace(30.0, 120.0, 91)
WEIGHTS = np.ones_like(ENERGIES)
AT_ENERGY = BASIS.evaluate(np.array([ENERGY]))[:, 0]


def curve_of(*names):
    return MaterialCurve.of([Material(n, composition=n) for n in names], BASIS, ENERGIES, WEIGHTS)


CURVE = curve_of("Ti", "water", "cortical bone", "adipose")


def test_materials_are_in_order_of_their_attenuation():
    assert CURVE.materials == ("adipose", "water", "cortical bone", "Ti")
    expected = [Material(n, composition=n).attenuation(np.array([ENERGY]))[0] for n in CURVE.materials]
    np.testing.assert_allclose(CURVE.attenuations, expected, rtol=0.02)  # two functions describe each within 2 %


def test_a_material_has_its_own_coefficients_and_vacuum_none():
    values = CURVE.values(np.array([0.0, *CURVE.attenuations]))
    np.testing.assert_allclose(values.T, np.array([(0, 0), *CURVE.coefficients]), atol=1e-14)


@given(st.lists(st.floats(0, 2), min_size=1, max_size=20))
def test_coefficients_have_the_attenuation_that_they_are_asked_for(wanted):
    wanted = np.array(wanted)
    np.testing.assert_allclose(AT_ENERGY @ CURVE.values(wanted), wanted, rtol=1e-12, atol=1e-15)


@given(st.floats(1e-4, 1.0))
def test_slopes_are_those_of_finite_differences(place):
    step = 1e-7
    if min(abs(place - a) for a in CURVE.attenuations) < 2 * step:
        return
    near = np.array([place - step, place, place + step])
    values = CURVE.values(near)
    np.testing.assert_allclose(CURVE.slopes(near)[:, 1], (values[:, 2] - values[:, 0]) / (2 * step), rtol=1e-5)


def test_between_two_materials_lies_their_mixture():
    water, bone = CURVE.attenuations[1:3]
    mixed = CURVE.values(np.array([0.25 * water + 0.75 * bone]))[:, 0]
    np.testing.assert_allclose(mixed, 0.25 * np.array(CURVE.coefficients[1]) + 0.75 * np.array(CURVE.coefficients[2]))


def test_the_type_and_shape_of_the_attenuation_are_kept():
    values = CURVE.values(np.zeros((2, 3, 4), np.float32))
    assert values.shape == (2, 2, 3, 4)
    assert values.dtype == np.float32 == CURVE.slopes(np.zeros(3, np.float32)).dtype


def test_materials_that_attenuate_alike_are_refused():
    with pytest.raises(InputError, match=r"different attenuations at 70 keV, ascending from 0, got water .* water"):
        curve_of("water", "water")
    with pytest.raises(InputError, match="at least one material"):
        curve_of()
