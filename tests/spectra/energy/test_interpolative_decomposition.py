import numpy as np
import pytest

from spectra.energy.interpolative_decomposition import interpolative_decomposition
from spectra.materials.material import Material
from spectra.materials.mixing import Part, dissolve

ENERGY = np.linspace(20.0, 140.0, 200)


def test_a_series_of_solutions_is_spanned_by_two_of_them():
    series = [dissolve(str(c), Part.of("water", 0), [Part.of("I", c)]) for c in (0, 1, 2, 5, 10, 20)]
    curves = np.stack([material.attenuation(ENERGY) for material in series])
    lengths = np.random.default_rng(0).uniform(0, 50, (300, 6))
    picked, mixture, error = interpolative_decomposition(curves, lengths, 1e-9)
    assert len(picked) == 2
    assert error < 1e-12
    np.testing.assert_allclose(mixture @ curves[picked], curves, rtol=1e-11)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-6])
def test_the_error_is_kept_on_every_ray(tolerance):
    names = ["blood", "liver", "kidney", "brain", "muscle", "adipose", "breast", "cranium", "water", "PMMA"]
    curves = np.stack([Material(name, composition=name).attenuation(ENERGY) for name in names])
    lengths = np.random.default_rng(1).uniform(0, 30, (500, len(names)))
    picked, mixture, error = interpolative_decomposition(curves, lengths, tolerance)
    assert np.abs(lengths @ curves - lengths @ mixture @ curves[picked]).max() == pytest.approx(error, abs=1e-12)
    assert error <= tolerance
    assert len(picked) < len(names)


def test_columns_that_nothing_spans_are_all_kept():
    picked, mixture, error = interpolative_decomposition(np.eye(4), np.ones((3, 4)), 1e-6)
    assert (len(picked), error) == (4, 0.0)
    np.testing.assert_array_equal(mixture @ np.eye(4)[picked], np.eye(4))
    assert len(interpolative_decomposition(np.ones((2, 3)), np.empty((0, 2)), 1e-6)[0]) == 1


def test_a_column_that_no_ray_meets_stays_a_finite_combination():
    energy = np.linspace(30, 100, 40)
    one, other = (Material(name, composition=name).attenuation(energy) for name in ("Al", "Fe"))
    columns = np.stack([one, other, one + other])
    lengths = np.column_stack([np.linspace(1, 5, 20), np.linspace(5, 0, 20), np.zeros(20)])
    found = interpolative_decomposition(columns, lengths, 1e-9)
    assert found.error <= 1e-9
    np.testing.assert_allclose(found.mixture @ columns[found.picked], columns)
