import numpy as np
import pytest
import xraylib
from hypothesis import given
from hypothesis import strategies as st
from scipy.constants import physical_constants

from spectra.basis.basis import KINDS, Basis, BasisFunction, klein_nishina
from spectra.basis.conditioning import conditioning_of
from spectra.errors import InputError

ENERGY = np.linspace(20.0, 140.0, 241)


def test_klein_nishina_agrees_with_published_values():
    # Total cross sections per electron at 20, 70, 140 keV [barn].
    expected = np.array([0.617987, 0.530923, 0.452295])
    radius_squared = 0.0794078
    np.testing.assert_allclose(
        2 * np.pi * radius_squared * klein_nishina(np.array([20, 70, 140.0])), expected, rtol=2e-6
    )
    ours = klein_nishina(ENERGY) / klein_nishina(np.array([70.0]))
    theirs = np.array([xraylib.CS_KN(float(e)) for e in ENERGY]) / xraylib.CS_KN(70.0)
    np.testing.assert_allclose(ours, theirs, rtol=3e-6)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_klein_nishina_is_that_of_xraylib_whatever_the_precision_of_the_energies(dtype):
    """From 1 to 800 keV; in float32 the closed form would err by 0.7 % at 5 keV and by 230 % at 1 keV."""
    energy = np.array([1, 2, 5, 10, 20, 40, 70, 100, 140, 300, 800], dtype=dtype)
    barn = 1e28 * 2 * np.pi * physical_constants["classical electron radius"][0] ** 2
    theirs = [xraylib.CS_KN(float(e)) for e in energy]
    np.testing.assert_allclose(barn * klein_nishina(energy), theirs, rtol=1e-6)


def test_raw_functions_are_one_at_their_normalisation_energy():
    assert BasisFunction("photoelectric").evaluate(np.array([70.0]))[0] == 1
    assert BasisFunction("compton").evaluate(np.array([70.0]))[0] == 1
    assert BasisFunction("step", edge_energy=63.3).evaluate(np.array([70.0]))[0] == 1
    gold = BasisFunction("step", element="Au")
    assert gold.normalisation_energy() == pytest.approx(80.7249)
    assert gold.evaluate(np.array([gold.edge_energy]))[0] == pytest.approx(1, rel=1e-12)
    assert BasisFunction("sigmoid", edge_energy=63.3, edge_width=1.0).evaluate(np.array([63.3]))[0] == pytest.approx(
        0.5
    )
    assert BasisFunction("element", element="Lu").evaluate(np.array([70.01]))[0] == pytest.approx(1, rel=1e-12)


def test_a_sharp_step_is_zero_below_and_falls_as_a_cube_above():
    step = BasisFunction("step", edge_energy=63.3)
    np.testing.assert_array_equal(step.evaluate(np.array([20, 63.2999])), 0)
    np.testing.assert_allclose(step.evaluate(np.array([63.3, 126.6])), (np.array([63.3, 126.6]) / 70) ** -3)
    assert step.edge_slope == np.inf


def test_an_element_is_its_attenuation_curve():
    from spectra.elements.attenuation import mass_attenuation

    curve = BasisFunction("element", element="Gd").evaluate(ENERGY)
    exact = mass_attenuation("Gd", ENERGY)
    np.testing.assert_allclose(curve / curve[0], exact / exact[0], rtol=1e-12)


def test_huge_widths_and_slopes_do_not_overflow():
    energy = np.array([1.0, 800.0])
    assert np.isfinite(BasisFunction("sigmoid", edge_energy=63.3, edge_width=1e-6).evaluate(energy)).all()


def test_names_follow_the_file_format(basis):
    assert basis.names == ("photoelectric", "compton", "kedge_63.3")
    assert BasisFunction("element", element="Lu").name == "kedge_Lu"
    assert basis.breaks == (63.3,)


functions = st.builds(
    lambda edge, width, kind: BasisFunction(kind, edge_energy=edge, edge_width=width),
    st.floats(25, 100),
    st.floats(0, 5),
    st.sampled_from(["step", "sigmoid"]),
)


@given(functions)
def test_a_table_gives_the_basis_back(kedge):
    basis = Basis((BasisFunction("photoelectric"), BasisFunction("element", element="Lu"), kedge))
    table = basis.to_dict()
    table["basis_name"] = [name.encode() for name in table["basis_name"]]
    assert Basis.from_table(table) == basis


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: BasisFunction("pear"), "unknown kind"),
        (lambda: BasisFunction("step"), "edge energy or an element"),
        (lambda: BasisFunction("element"), "needs an element"),
        (lambda: BasisFunction("element", edge_energy=63.3), "needs an element"),
        (lambda: BasisFunction("step", edge_energy=-1.0), "must be positive"),
        (lambda: BasisFunction("step", edge_energy=60.0, edge_width=-1.0), "not negative"),
        (lambda: BasisFunction("compton", edge_energy=60.0), "no edge"),
        (lambda: Basis(()), "at least one"),
        (lambda: Basis((BasisFunction("compton"), BasisFunction("compton"))), "two basis functions"),
    ],
)
def test_impossible_functions_are_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()


def test_kinds_are_those_of_the_documentation():
    assert KINDS == ("photoelectric", "compton", "sigmoid", "step", "element", "material", "svd")


def test_conditioned_columns_are_orthonormal_and_convert_both_ways(basis):
    raw = basis.evaluate(ENERGY)
    photons = np.exp(-(((ENERGY - 70) / 30) ** 2))
    change = conditioning_of(raw, photons)
    columns = change.columns(raw)
    np.testing.assert_allclose((columns * photons / photons.sum()) @ columns.T, np.eye(3), atol=1e-10)
    alpha = np.random.default_rng(0).random((5, 3))
    np.testing.assert_allclose(change.conditioned(alpha) @ columns, alpha @ raw, rtol=1e-10)
    np.testing.assert_allclose(change.raw(change.conditioned(alpha)), alpha, rtol=1e-10)


def test_near_collinear_functions_are_conditioned_and_equal_ones_refused():
    photons = np.ones_like(ENERGY)
    near = [BasisFunction("step", edge_energy=e, edge_width=1.0).evaluate(ENERGY) for e in (63.3, 63.31)]
    columns = conditioning_of(np.stack(near), photons).columns(np.stack(near))
    np.testing.assert_allclose(columns @ columns.T / len(ENERGY), np.eye(2), atol=1e-6)
    with pytest.raises(InputError, match="functions 0 and 1 cannot be told apart"):
        conditioning_of(np.stack([near[0], 2 * near[0]]), photons)
    with pytest.raises(InputError, match="function 1 vanishes"):
        conditioning_of(np.stack([near[0], 0 * near[0]]), photons)
