"""Volume fractions of materials: exact for mixtures, the nearest mixture elsewhere."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from recon.readouts.fractions import Decomposition, parse_material
from spectra.basis.basis import Basis, BasisFunction
from spectra.errors import InputError
from spectra.materials.material import Material

ENERGY = np.arange(30.0, 101.0)
WEIGHTS = np.exp(-(((ENERGY - 60.0) / 20.0) ** 2))
TWO = Basis((BasisFunction("photoelectric"), BasisFunction("compton")))
IODINE = Basis((*TWO.functions, BasisFunction("element", element="I")))
TISSUES = ("adipose", "breast", "hydroxyapatite:3.16")


def decomposition(names: tuple[str, ...] = TISSUES, basis: Basis = TWO) -> Decomposition:
    return Decomposition.of([parse_material(name) for name in names], basis, ENERGY, WEIGHTS)


def coefficients(names: tuple[str, ...], basis: Basis) -> np.ndarray:
    return np.array([parse_material(name).coefficients_in(basis, ENERGY, WEIGHTS) for name in names])


@pytest.mark.parametrize(("basis", "names"), [(TWO, TISSUES), (IODINE, (*TISSUES, "I:0.01", "Ti"))])
def test_pure_materials_and_empty_space(basis: Basis, names: tuple[str, ...]) -> None:
    found = decomposition(names, basis).fractions(np.append(coefficients(names, basis), [np.zeros(len(basis))], 0).T)
    np.testing.assert_allclose(found, np.eye(len(names), len(names) + 1), atol=1e-9)


@settings(deadline=None)
@given(st.lists(st.floats(0.0, 1.0), min_size=3, max_size=3), st.integers(0, 3))
def test_mixtures_of_the_corners_of_a_simplex_are_found(shares: list[float], which: int) -> None:
    split = decomposition()
    simplex = split.simplices[which % len(split.simplices)]
    mixed = np.zeros(len(TISSUES) + 1)
    mixed[list(simplex)] = (np.array(shares) + 1e-3) / (np.sum(shares) + 3e-3)
    found = split.fractions((mixed[:-1] @ coefficients(TISSUES, TWO))[:, None])[:, 0]
    np.testing.assert_allclose(found, mixed[:-1], atol=1e-7)


@settings(deadline=None, max_examples=40)
@given(st.floats(-0.02, 0.2), st.floats(-0.02, 0.08))
def test_any_coefficients_give_the_nearest_mixture(photoelectric: float, compton: float) -> None:
    split = decomposition()
    values = np.array([photoelectric, compton])
    found = split.fractions(values[:, None])[:, 0]
    assert (found >= 0).all()
    assert found.sum() <= 1 + 1e-9
    place = split.metric @ values
    mixed = np.append(found, 1 - found.sum()) @ split.corners
    sums = {"type": "eq", "fun": lambda shares: shares.sum() - 1}
    start = np.full(len(split.corners), 0.25)
    best = minimize(
        lambda shares: 1e4 * np.sum((shares @ split.corners - place) ** 2),
        start,
        bounds=[(0, 1)] * len(start),
        constraints=sums,
        options={"ftol": 1e-14, "maxiter": 500},
    )
    assert 1e4 * np.sum((mixed - place) ** 2) <= best.fun + 1e-6


def test_simplices_fill_the_hull_once() -> None:
    split = decomposition((*TISSUES, "Al"))
    rng = np.random.default_rng(0)
    shares = rng.dirichlet(np.ones(5), 2000)
    places = (shares @ split.corners).T
    held = [(split._shares(simplex, places) > 1e-9).all(axis=0) for simplex in split.simplices]
    assert (np.sum(held, axis=0) <= 1).all()
    assert np.mean(np.sum(held, axis=0)) > 0.99


def test_distances_are_rms_differences_of_attenuation_over_the_spectrum() -> None:
    split = decomposition()
    values = coefficients(TISSUES, TWO)
    for i, j in combinations(range(len(TISSUES)), 2):
        curves = (values[i] - values[j]) @ TWO.evaluate(ENERGY)
        expected = np.sqrt(np.average(curves**2, weights=WEIGHTS))
        assert np.linalg.norm(split.corners[i] - split.corners[j]) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("names", [("water",), ("water", "Al")])
def test_one_function_tells_materials_in_one_line(names: tuple[str, ...]) -> None:
    one = Basis((BasisFunction("material", composition="Water, Liquid"),))
    found = decomposition(names, one).fractions(coefficients(names, one).T)
    np.testing.assert_allclose(found, np.eye(len(names)), atol=1e-9)


@pytest.mark.parametrize(
    ("names", "sentence"),
    [
        ((), "one or more different materials"),
        (("water", "water"), "one or more different materials, got water, water"),
        (("water", "water:0.5"), "one or more different materials"),
        (("water", "H2O:0.5"), "does not tell water, H2O and empty space apart: name fewer materials"),
    ],
)
def test_what_cannot_be_told_apart_is_refused(names: tuple[str, ...], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        decomposition(names)


def test_a_material_between_others_is_a_corner_where_the_basis_shows_it() -> None:
    half = Material("half", composition="water", density=0.5)
    materials = [Material("water", composition="water"), Material("Al", composition="Al"), half]
    split = Decomposition.of(materials, TWO, ENERGY, WEIGHTS)
    values = half.coefficients_in(TWO, ENERGY, WEIGHTS)[:, None]
    np.testing.assert_allclose(split.fractions(values)[:, 0], [0, 0, 1], atol=1e-6)


@pytest.mark.parametrize(
    ("text", "sentence"), [("water:x", "such as hydroxyapatite:2.9, got 'water:x'"), ("C5H8O2", "density")]
)
def test_text_of_a_material(text: str, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        parse_material(text)
