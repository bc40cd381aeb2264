"""Bases of materials, singular vectors, and coefficients from one basis to another."""

import numpy as np
import pytest

from spectra.basis.basis import Basis, BasisFunction
from spectra.basis.change import basis_change, svd_functions
from spectra.basis.conditioning import conditioning_of
from spectra.elements.attenuation import mass_attenuation
from spectra.elements.element_sums import amounts_of, curve, from_text, to_text
from spectra.errors import InputError
from spectra.materials.material import Material

ENERGY = np.linspace(20.0, 120.0, 401)
WEIGHTS = np.exp(-(((ENERGY - 60) / 25) ** 2))
BONE = "Bone, Cortical (ICRP)"
SET = {"water": "water", "bone": BONE, "iodine": "I", "adipose": "adipose"}


def material(name, composition):
    return BasisFunction("material", name=name, composition=composition)


WATER_BONE_IODINE = Basis((material("water", "water"), material("bone", BONE), material("iodine", "I")))
PHYSICAL = Basis((BasisFunction("photoelectric"), BasisFunction("compton"), BasisFunction("element", element="I")))


def test_a_material_function_is_its_curve_relative_to_70_keV():
    values = WATER_BONE_IODINE.evaluate(np.append(ENERGY, 70.0))
    np.testing.assert_allclose(values[:, -1], 1, rtol=1e-12)
    bone = mass_attenuation(BONE, ENERGY)
    np.testing.assert_allclose(values[1, :-1], bone / mass_attenuation(BONE, np.array([70.0])), rtol=1e-12)
    assert WATER_BONE_IODINE.names == ("water", "bone", "iodine")
    assert 33.1694 in np.round(WATER_BONE_IODINE.breaks, 4)
    assert not WATER_BONE_IODINE.signed


def test_a_material_of_the_basis_has_its_own_attenuation_as_coefficient():
    solution = Material("solution", 1.02, {"H": 0.11, "O": 0.87, "I": 0.02})
    found = solution.coefficients_in(Basis((material("solvent", {"H": 0.11 / 0.98, "O": 0.87 / 0.98}),
                                            material("iodine", "I"))), ENERGY, WEIGHTS)  # fmt: skip
    iodine = 0.02 * mass_attenuation("I", np.array([70.0]))[0] * 0.102
    assert found[1] == pytest.approx(iodine, rel=1e-6)
    assert found.sum() == pytest.approx(solution.attenuation(np.array([70.0]))[0], rel=1e-9)


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_singular_vectors_are_orthonormal_and_describe_the_set_best(count):
    functions = svd_functions(SET, count, ENERGY, WEIGHTS)
    basis = Basis(functions)
    share = WEIGHTS / WEIGHTS.sum()
    values = basis.evaluate(ENERGY)
    np.testing.assert_allclose((values * share) @ values.T, np.eye(count), atol=1e-9)
    assert (values @ share >= 0).all()
    assert basis.signed
    curves = np.stack([mass_attenuation(c, ENERGY) for c in SET.values()])
    curves /= np.sqrt((curves**2 * share).sum(axis=1))[:, None]
    missing = curves - (curves * share) @ values.T @ values
    best = np.linalg.svd(curves * np.sqrt(share), compute_uv=False)[count:]
    assert np.sqrt((missing**2 * share).sum()) == pytest.approx(np.sqrt((best**2).sum()), abs=1e-10)


def test_three_singular_vectors_describe_tissues_to_a_tenth_of_a_percent():
    names = ("water", "adipose", "muscle", "Bone, Cortical (ICRP)", "Al", "Ti", "Fe")
    basis = Basis(svd_functions({n: n for n in names}, 3, ENERGY, WEIGHTS))
    errors = [Material(n, composition=n).fit_error(basis, ENERGY, WEIGHTS) for n in names]
    assert max(errors) < 1e-3


def test_bases_that_span_each_other_convert_both_ways():
    vectors = Basis(svd_functions({k: SET[k] for k in ("water", "bone", "iodine")}, 3, ENERGY, WEIGHTS))
    there = basis_change(WATER_BONE_IODINE, vectors, ENERGY, WEIGHTS)
    back = basis_change(vectors, WATER_BONE_IODINE, ENERGY, WEIGHTS)
    assert there.exact
    assert back.exact
    alpha = np.random.default_rng(0).random((5, 2, 3))
    np.testing.assert_allclose(back.coefficients(there.coefficients(alpha)), alpha, rtol=1e-8)
    everywhere = np.linspace(10.0, 150.0, 99)  # exact at other energies too
    mu = alpha @ WATER_BONE_IODINE.evaluate(everywhere)
    np.testing.assert_allclose(there.coefficients(alpha) @ vectors.evaluate(everywhere), mu, rtol=1e-8)


def test_a_larger_basis_spans_a_smaller_one_but_not_the_other_way_round():
    two = Basis(WATER_BONE_IODINE.functions[:2])
    assert basis_change(two, WATER_BONE_IODINE, ENERGY, WEIGHTS).exact
    down = basis_change(WATER_BONE_IODINE, two, ENERGY, WEIGHTS)
    assert not down.exact
    np.testing.assert_allclose(down.residuals[:2], 0, atol=1e-12)
    assert 0.1 < down.residuals[2] < 1


def test_least_squares_states_what_is_lost():
    change = basis_change(WATER_BONE_IODINE, PHYSICAL, ENERGY, WEIGHTS)
    assert not change.exact
    assert (change.residuals[:2] < 5e-3).all()
    assert change.residuals[2] < 1e-9  # iodine is in both
    fitted, exact = change.matrix @ PHYSICAL.evaluate(ENERGY), WATER_BONE_IODINE.evaluate(ENERGY)
    lost = np.sqrt(((fitted - exact) ** 2 * WEIGHTS).sum(axis=1) / (exact**2 * WEIGHTS).sum(axis=1))
    np.testing.assert_allclose(change.residuals, lost, atol=1e-12)


def test_several_edges_convert_one_by_one():
    two = [BasisFunction("element", element=e) for e in ("I", "Gd")]
    basis = Basis((*PHYSICAL.functions[:2], *two))
    change = basis_change(basis, Basis(basis.functions[::-1]), ENERGY, WEIGHTS)
    np.testing.assert_allclose(change.matrix, np.eye(4)[::-1], atol=1e-9)


def test_conditioning_makes_a_material_basis_orthonormal():
    raw = WATER_BONE_IODINE.evaluate(ENERGY)
    columns = conditioning_of(raw, WEIGHTS).columns(raw) * np.sqrt(WEIGHTS / WEIGHTS.sum())
    assert np.linalg.cond(columns) == pytest.approx(1, abs=1e-6)
    assert np.linalg.cond(raw * np.sqrt(WEIGHTS)) > 5


@pytest.mark.parametrize("basis", [WATER_BONE_IODINE, Basis(svd_functions(SET, 3, ENERGY, WEIGHTS)), PHYSICAL])
def test_a_table_gives_the_basis_back(basis):
    table = {k: [t.encode() for t in v] if isinstance(v, list) else v for k, v in basis.to_dict().items()}
    same = Basis.from_table(table)
    assert same == basis
    np.testing.assert_array_equal(same.evaluate(ENERGY), basis.evaluate(ENERGY))
    assert ("basis_composition" in table) == (basis is not PHYSICAL)


def test_amounts_as_text():
    amounts = amounts_of("CaCO3")
    assert from_text(to_text(amounts)) == amounts
    np.testing.assert_allclose(curve(amounts, ENERGY), mass_attenuation("CaCO3", ENERGY), rtol=1e-12)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: BasisFunction("material"), "a material basis function needs a composition"),
        (lambda: BasisFunction("compton", composition="water"), "has no composition"),
        (lambda: BasisFunction("material", composition="watr"), "did you mean 'water'"),
        (lambda: svd_functions(SET, 5, ENERGY, WEIGHTS), "4 materials give 1 to 4 functions, not 5"),
        (lambda: svd_functions({"a": "H2O", "b": "H4O2"}, 2, ENERGY, WEIGHTS), "a, b span 1 functions, not 2"),
        (
            lambda: basis_change(PHYSICAL, Basis((material("a", "Al"), material("b", "Al"))), ENERGY, WEIGHTS),
            "a, b cannot be told apart",
        ),
        (
            lambda: basis_change(PHYSICAL, Basis((BasisFunction("step", edge_energy=130.0),)), ENERGY, WEIGHTS),
            "'kedge_130' vanishes",
        ),
        (lambda: from_text("H 0.1 O"), "must read like"),
        (lambda: from_text("H much"), "must read like"),
    ],
)
def test_impossible_requests_are_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()
