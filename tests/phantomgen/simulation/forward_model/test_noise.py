"""Poisson noise: distribution, and independence from everything but its key."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chisquare, poisson

from phantomgen.effects.random_streams import Stream, philox_key
from phantomgen.simulation.forward_model.photon_noise import poisson_counts
from spectra.errors import InputError


@pytest.mark.parametrize("mean", [0.5, 7.0, 30.0])
def test_counts_follow_the_poisson_distribution(mean):
    counts = poisson_counts(np.full((200, 200), mean), seed=1, frame=2, channel=3).ravel()
    top = int(poisson.ppf(1 - 1e-3, mean))
    observed = np.bincount(np.minimum(counts, top), minlength=top + 1)
    expected = np.append(poisson.pmf(np.arange(top), mean), poisson.sf(top - 1, mean))
    kept = expected * counts.size > 5
    merged = [np.append(x[kept], x[~kept].sum()) for x in (observed, expected * counts.size)]
    positive = merged[1] > 0
    assert (
        chisquare(
            merged[0][positive], merged[1][positive] * merged[0][positive].sum() / merged[1][positive].sum()
        ).pvalue
        > 1e-3
    )


def test_large_means_have_poisson_mean_and_variance():
    counts = poisson_counts(np.full((300, 300), 2e5), seed=0, frame=0, channel=0)
    assert counts.dtype == np.int32
    assert abs(counts.mean() - 2e5) < 5 * np.sqrt(2e5 / counts.size)
    assert counts.var() == pytest.approx(2e5, rel=0.03)


def test_a_dark_pixel_counts_nothing_and_changes_no_other():
    mean = np.full((4, 4), 100.0)
    with_dark = mean.copy()
    with_dark[-1, -1] = 0.0
    assert poisson_counts(with_dark, 0, 0, 0)[-1, -1] == 0
    assert (poisson_counts(with_dark, 0, 0, 0).ravel()[:-1] == poisson_counts(mean, 0, 0, 0).ravel()[:-1]).all()


KEYS = st.tuples(
    st.integers(0, 2**64 - 1), st.sampled_from(Stream), st.integers(0, 2**32 - 1), st.integers(0, 2**24 - 1)
)


@given(KEYS, KEYS)
@settings(max_examples=200)
def test_keys_are_equal_only_for_equal_images(first, second):
    assert (philox_key(*first) == philox_key(*second)) == (first == second)
    assert 0 <= philox_key(*first) < 2**128


def test_images_of_other_views_channels_and_seeds_are_independent():
    mean = np.full((64, 64), 50.0)
    images = [poisson_counts(mean, *key).ravel() for key in [(0, 0, 0), (0, 0, 1), (0, 1, 0), (1, 0, 0)]]
    images.append(poisson_counts(mean, 0, 0, 0, Stream.FLAT).ravel())
    correlation = np.corrcoef(images) - np.eye(len(images))
    assert np.abs(correlation).max() < 5 / np.sqrt(mean.size)


def test_the_stream_of_random_numbers_is_frozen():
    # Values of this generator ; a change would silently change every dataset.
    assert poisson_counts(np.full((1, 6), 1000.0), 7, 3, 1).tolist() == FROZEN


FROZEN = [[1020, 966, 950, 997, 952, 1010]]


@pytest.mark.parametrize("bad", [-1.0, np.nan, np.inf, 2.0**31])
def test_impossible_means_are_refused(bad):
    with pytest.raises(InputError, match="expected counts must lie in"):
        poisson_counts(np.array([[1.0, bad]]), 0, 0, 0)


@pytest.mark.parametrize("seed", [-1, 2**64])
def test_seeds_outside_64_bits_are_refused(seed):
    with pytest.raises(InputError, match="seed"):
        poisson_counts(np.ones((1, 1)), seed, 0, 0)
