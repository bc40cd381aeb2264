"""Lower doses against probability theory, against simulations of the lower dose, and against published formulas."""

import numpy as np
import pytest
from scipy import stats

from phantomgen.degradation.dose import (
    counts_at_dose,
    dose_seed,
    line_integrals_at_dose,
    signal_at_dose,
    thinned,
)

SEEDS = range(200)
COUNTS = np.random.RandomState(0).poisson(40.0, (16, 16))
NONE = np.zeros((16, 16))


def scans(function):
    return np.stack([function(np.random.RandomState(seed)) for seed in SEEDS])


def test_thinning_by_one_changes_nothing():
    assert np.array_equal(thinned(COUNTS, 1.0, np.random.RandomState(1)), COUNTS)


@pytest.mark.parametrize("dose", [0.1, 0.25, 0.9])
def test_thinned_counts_and_their_complement_are_the_original(dose):
    kept, other = (counts_at_dose(COUNTS, NONE, dose, other, np.random.RandomState(3)) for other in (False, True))
    assert np.array_equal(kept + other, COUNTS)
    assert (kept >= 0).all()
    assert (other >= 0).all()


@pytest.mark.parametrize("mean", [0.5, 40.0, 5000.0])
def test_thinned_poisson_counts_are_poisson_counts_of_the_lower_mean(mean):
    kept = scans(lambda random: thinned(random.poisson(mean, (16, 16)), 0.25, random))
    number = kept.size
    assert kept.mean() == pytest.approx(0.25 * mean, abs=5 * np.sqrt(0.25 * mean / number))
    # the variance of a sample variance is close to 2 var^2 / n + (fourth cumulant) / n
    assert kept.var() == pytest.approx(0.25 * mean, abs=5 * np.sqrt((2 * (0.25 * mean) ** 2 + 0.25 * mean) / number))


def test_the_distribution_is_poisson_and_not_only_its_variance():
    kept = scans(lambda random: thinned(random.poisson(12.0, (16, 16)), 0.25, random)).ravel()
    found = np.bincount(np.minimum(kept, 10), minlength=11)
    chances = stats.poisson(3.0).pmf(np.arange(10))
    expected = kept.size * np.append(chances, 1 - chances.sum())
    assert stats.chisquare(found, expected).pvalue > 1e-3


def test_kept_and_other_counts_are_independent_where_the_original_is_poisson():
    def both(random):
        counts = random.poisson(40.0, (16, 16))
        kept = thinned(counts, 0.5, random)
        return np.stack([kept, counts - kept])

    kept, other = scans(both).swapaxes(0, 1).reshape(2, -1)
    assert abs(np.corrcoef(kept, other)[0, 1]) < 5 / np.sqrt(kept.size)


@pytest.mark.parametrize("complement", [False, True])
def test_counts_without_beam_do_not_depend_on_the_dose(complement):
    dark = np.full((16, 16), 8.0)
    low = scans(lambda random: counts_at_dose(random.poisson(40.0 + dark), dark, 0.25, complement, random))
    mean = (0.75 if complement else 0.25) * 40.0 + 8.0
    assert low.mean() == pytest.approx(mean, abs=5 * np.sqrt(mean / low.size))
    assert low.var() == pytest.approx(mean, rel=5 * np.sqrt(2.1 / low.size))


def test_a_signal_has_the_mean_and_the_variance_of_a_scan_of_the_lower_dose():
    """Photons of 60 keV, electronics of 100 keV, an offset: both scans drawn photon by photon."""
    quantum, sigma, offset, dose, photons = 60.0, 100.0, 5000.0, 0.25, 200.0

    def reading(mean, random):
        shape = (16, 16)
        return quantum * random.poisson(mean, shape) + offset + sigma * random.standard_normal(shape)

    dark = np.full((16, 16), offset)
    made = scans(lambda random: signal_at_dose(reading(photons, random), dark, dose, quantum, sigma**2, random))
    real = scans(lambda random: reading(dose * photons, random))
    assert made.mean() == pytest.approx(real.mean(), abs=5 * np.sqrt(2 * real.var() / real.size))
    assert made.var() == pytest.approx(real.var(), rel=5 * np.sqrt(4.5 / real.size))
    assert made.var() == pytest.approx(dose * photons * quantum**2 + sigma**2, rel=5 * np.sqrt(2.2 / real.size))


def test_a_signal_at_full_dose_does_not_change():
    signal = np.linspace(10.0, 1000.0, 12).reshape(3, 4)
    assert signal_at_dose(signal, np.ones((3, 4)), 1.0, 60.0, 1e4, np.random.RandomState(0)) == pytest.approx(signal)


@pytest.mark.parametrize("electronics", [0.0, 2000.0])
def test_log_projections_get_the_noise_of_signals(electronics):
    air, dose, depth = 1e5, 0.2, 1.5
    signal = air * np.exp(-depth)

    def from_signals(random):
        full = random.poisson(signal, (32, 32)) + np.sqrt(electronics) * random.standard_normal((32, 32))
        low = signal_at_dose(full, np.zeros((32, 32)), dose, 1.0, electronics, random)
        return -np.log(low / (dose * air))

    def from_logs(random):
        full = random.poisson(signal, (32, 32)) + np.sqrt(electronics) * random.standard_normal((32, 32))
        return line_integrals_at_dose(-np.log(full / air), dose, air, electronics, random)

    logs, signals = scans(from_logs), scans(from_signals)
    assert logs.var() == pytest.approx(signals.var(), rel=0.01)
    assert logs.var() == pytest.approx(1 / (dose * signal) + electronics / (dose * signal) ** 2, rel=0.01)


def test_doses_seeds_and_steps_have_seeds_of_their_own():
    found = {dose_seed(seed, dose, step) for seed in (0, 1) for dose in (0.5, 0.25) for step in (2, 3)}
    assert len(found) == 8
    assert dose_seed(0, 0.5, 2) == dose_seed(0, 1 / 2, 2)
