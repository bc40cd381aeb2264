import numpy as np
import pytest

from spectra.detector.dead_time import DeadTime, corrected_spread
from spectra.errors import InputError

MODELS = ("nonparalyzable", "paralyzable")


def events(load):
    """Three channels of one pixel with so many events per dead time; 1 ms holds 1e5 dead times of 10 ns."""
    return load * 1e5 * np.array([0.5, 0.3, 0.2])[:, None, None]


@pytest.mark.parametrize(("model", "recorded"), [("nonparalyzable", 0.5 / 1.5), ("paralyzable", 0.5 * np.exp(-0.5))])
def test_counts_are_lost_as_the_models_say(model, recorded):
    found = DeadTime(10, 1, model).recorded(events(0.5))
    np.testing.assert_allclose(found.sum(), recorded * 1e5)
    np.testing.assert_allclose(found[:, 0, 0] / found.sum(), [0.5, 0.3, 0.2])


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("load", [0.0, 1e-4, 0.1, 0.5, 0.99])
def test_corrected_counts_are_the_events(model, load):
    dead_time = DeadTime(10, 1, model)
    np.testing.assert_allclose(dead_time.corrected(dead_time.recorded(events(load))), events(load), rtol=1e-6)


@pytest.mark.parametrize("model", MODELS)
def test_impossible_counts_are_corrected_to_something_finite(model):
    dead_time = DeadTime(10, 1, model)
    for recorded in (events(0.9999), events(1.5), events(1e6)):
        assert np.isfinite(dead_time.corrected(recorded)).all()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ((0, 1), "the dead time must be positive and finite, got 0 ns"),
        ((10, np.nan), "the exposure must be positive"),
        ((10, 1, "dead"), "unknown model of dead time 'dead'"),
    ],
)
@pytest.mark.wrong_types
def test_impossible_dead_times_are_refused(options, words):
    with pytest.raises(InputError, match=words):
        DeadTime(*options)


@pytest.mark.parametrize("model", MODELS)
def test_corrected_counts_vary_as_drawn_ones_do(model):
    rng, dead_time, exposure = np.random.default_rng(2), DeadTime(10, 0.05, model), 5000  # dead times
    mean, found = events(0.3) * 0.05, np.empty((4000, 3))
    for frame in range(len(found)):
        arrivals = np.sort(rng.uniform(0, exposure, rng.poisson(mean.sum())))
        if model == "paralyzable":
            recorded = np.diff(arrivals, prepend=-2.0) > 1
        else:
            recorded, free = np.zeros(len(arrivals), bool), 0.0
            for i, arrival in enumerate(arrivals.tolist()):
                if arrival >= free:
                    recorded[i], free = True, arrival + 1
        kinds = rng.choice(3, len(arrivals), p=mean[:, 0, 0] / mean.sum())
        counts = np.bincount(kinds[recorded], minlength=3).astype(float)
        found[frame] = dead_time.corrected(counts[:, None, None])[:, 0, 0]
    spread = corrected_spread(mean, dead_time.recorded, dead_time)[:, 0, 0]
    assert (spread > 1.25).all()
    np.testing.assert_allclose(found.var(axis=0) / mean[:, 0, 0], spread, rtol=0.1)


def test_without_events_the_spread_is_that_of_poisson_counts():
    dead_time = DeadTime(10, 1)
    np.testing.assert_array_equal(corrected_spread(np.zeros((3, 2, 2)), dead_time.recorded, dead_time), 1)
