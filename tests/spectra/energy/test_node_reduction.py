import numpy as np
import pytest

from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.transmission import Transmission

HIGH = np.array([0.5, 3.5, 0.7])


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6])
def test_compression_keeps_its_promise_on_other_rays(transmission_on, tolerance):
    full = transmission_on(480)
    small, error = full.compress(np.zeros(3), HIGH, tolerance)
    assert error <= tolerance
    assert len(small.weights) <= {1e-4: 20, 1e-6: 40}[tolerance]
    assert small.channel_names == full.channel_names
    assert (small.weights > 0).all()
    rays = np.random.default_rng(99).uniform(0, 1, (3000, 3)) * HIGH
    found, wanted = (np.log(model.expected(rays)) for model in (small, full))
    assert np.abs(found - wanted).max() < 2 * tolerance


def test_without_refinement_given_nodes_are_chosen(transmission_on):
    full = transmission_on(480)
    small, error = full.compress(np.zeros(3), HIGH, 1e-6, refine=False)
    assert error <= 1e-6
    assert len(small.weights) < 120
    given = {tuple(column) for column in full.columns.T.round(12)}
    assert {tuple(column) for column in small.columns.T.round(12)} <= given


def test_compression_is_reproducible(transmission_on):
    full = transmission_on(128)
    first, second = (full.compress(np.zeros(3), HIGH, 1e-5, seed=4)[0] for _ in range(2))
    np.testing.assert_array_equal(first.weights, second.weights)
    np.testing.assert_array_equal(first.columns, second.columns)


@pytest.mark.parametrize("tolerance", [1e-3, 2.5e-4, 1e-4, 1e-5])
@pytest.mark.parametrize("nodes", [64, 200, 480])
def test_rounding_of_other_processors_changes_counts_by_no_more_than_rounding(transmission_on, tolerance, nodes):
    full = transmission_on(nodes)
    rays = np.random.default_rng(99).uniform(0, 1, (500, 3)) * HIGH
    random, found = np.random.default_rng(7), []
    for size in (0.0, 4e-16, 4e-16, 4e-16):
        columns, weights = (a * (1 + size * random.uniform(-1, 1, a.shape)) for a in (full.columns, full.weights))
        rounded = Transmission(columns, weights, full.starts)
        found.append(np.log(rounded.compress(np.zeros(3), HIGH, tolerance)[0].expected(rays)))
    assert np.abs(np.array(found[1:]) - found[0]).max() < 1e-9


def test_six_columns_of_materials_that_span_three_dimensions(transmission_on):
    full = transmission_on(128)
    mixtures = np.random.default_rng(5).uniform(0.001, 0.02, (6, 3))
    materials = Transmission(mixtures @ full.columns, full.weights, full.starts)
    small, error = materials.compress(np.zeros(6), np.full(6, 40.0), 1e-4)
    assert error <= 1e-4
    assert len(small.weights) < 40


def test_nothing_to_save_is_left_alone():
    one = Transmission(np.array([[0.2], [0.4]]), np.array([10.0]), np.array([0, 1, 1]))
    same, error = one.compress(np.zeros(2), np.full(2, 10.0), 1e-6)
    assert error == 0
    np.testing.assert_array_equal(same.columns, one.columns)
    np.testing.assert_array_equal(same.starts, [0, 1, 1])


def test_a_column_that_the_box_never_reaches_does_no_harm(transmission_on):
    small, error = transmission_on(128).compress(np.zeros(3), np.array([0.3, 3.0, 0.0]), 1e-5)
    assert error <= 1e-5
    assert np.isfinite(small.columns).all()


@pytest.mark.parametrize(
    ("low", "high", "tolerance", "words"),
    [
        ([1, 0, 0], [0, 1, 1], 1e-4, "box"),
        ([0, 0], [1, 1], 1e-4, "3 entries"),
        ([0, 0, 0], [1, 1, np.inf], 1e-4, "box"),
        ([0, 0, 0], [1, 1, 1], 0.0, "tolerance"),
    ],
)
@pytest.mark.wrong_types
def test_impossible_requests_are_refused(transmission_on, low, high, tolerance, words):
    with pytest.raises(InputError, match=words):
        transmission_on(64).compress(low, high, tolerance)


def many_elements(count):
    """Elements with K edges of their own in the spectrum, on 0.25 keV bins: no curve is a combination of the others."""
    names = ["I", "Ba", "La", "Ce", "Nd", "Sm", "Gd", "Dy", "Er", "Yb", "Ta", "W", "Au", "Bi"][:count]
    energy = np.arange(25.0, 140.0, 0.25)
    curves = np.stack([Material(name, composition=name, density=0.02).attenuation(energy) for name in names])
    weights = np.exp(-(((energy - 70) / 35) ** 2))[None] * 1e4
    return Transmission.from_spectrum(weights, curves)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-7])
def test_nodes_are_chosen_along_rays_where_columns_are_many(tolerance):
    full = many_elements(14)
    rays = np.random.default_rng(0).uniform(0, 20, (1500, 14)) * (np.random.default_rng(1).random((1500, 14)) < 0.3)
    few, error = full.choose(rays, tolerance)
    assert error <= tolerance
    assert len(few.weights) < 150
    other = np.random.default_rng(2).uniform(0, 20, (500, 14)) * (np.random.default_rng(3).random((500, 14)) < 0.3)
    assert np.abs(few.log_projection(other) - full.log_projection(other)).max() < 3 * tolerance
    assert {tuple(c) for c in few.columns.T} <= {tuple(c) for c in full.columns.T}


def test_all_nodes_are_kept_where_no_choice_is_good_enough():
    full = many_elements(14)
    kept, error = full.choose(np.eye(14)[:4], 1e-15)
    assert error == 0.0
    assert len(kept.weights) == len(full.weights)
