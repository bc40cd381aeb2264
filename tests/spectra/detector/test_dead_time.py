import numpy as np
import pytest

from spectra.detector.dead_time import DeadTime
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
