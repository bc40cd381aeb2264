"""Afterglow: impulse and step responses, and that a scan with it depends on nothing but its frames."""

import numpy as np
import pytest
from support.detector_scenes import counting, integrating, views_of

from phantomgen.dataset.reader import open_dataset
from phantomgen.effects import Lag
from phantomgen.simulation.forward_model.readout import projections
from phantomgen.simulation.run import simulate
from spectra.errors import InputError, SceneError
from spectra.threads import set_threads

LAG = Lag((0.03, 0.01), (1.5, 20.0))
SETTING = "effects.lag={fractions: [0.03, 0.01], decays: [1.5, 20]}"
SHORT = ["geometry.views=4", "geometry.test_views=2", "panel.rows=8", "panel.columns=10", "flats=1"]


def measured(signals, lag=LAG):
    stored, out = lag.empty(signals[0].shape), []
    for signal in signals:
        image, stored = lag.read(signal, stored)
        out.append(image)
    return np.array(out)


def test_all_of_a_signal_shows_at_some_time():
    assert LAG.response(2000).sum() == pytest.approx(1, abs=1e-9)
    assert LAG.response(1) == pytest.approx(0.96)
    assert len(LAG.response(5)) == 5


def test_an_impulse_gives_the_stated_response():
    signals = np.zeros((50, 1, 2, 2))
    signals[0] = 100.0
    np.testing.assert_allclose(measured(signals)[:, 0, 0, 0], 100 * LAG.response(50), rtol=1e-12)


def test_a_step_rises_by_exponentials():
    signals = np.full((60, 1, 1, 1), 7.0)
    views = np.arange(60)
    stored = sum(f * np.exp(-views / tau) for f, tau in zip(LAG.fractions, LAG.decays, strict=True))
    np.testing.assert_allclose(measured(signals)[:, 0, 0, 0], 7 * (1 - stored), rtol=1e-12)


def test_any_signals_are_convolved_with_the_response():
    signals = np.random.default_rng(0).normal(size=(30, 2, 3, 4))
    wanted = np.apply_along_axis(lambda s: np.convolve(s, LAG.response(30))[:30], 0, signals)
    np.testing.assert_allclose(measured(signals), wanted, atol=1e-13)


def test_a_few_views_before_tell_what_is_stored():
    signals = np.random.default_rng(1).uniform(1, 2, (400, 1, 3, 3))
    assert LAG.first_needed(390, {0, 10}) == 10
    assert LAG.first_needed(10, {0, 10}, tail=1e-6) == 10
    first = LAG.first_needed(390, {0, 10}, tail=1e-6)
    assert 100 < first < 390
    # The views that are forgotten hold up to twice a signal of 1, and 1e-6 of each is left.
    whole, some = measured(signals[10:])[380:], measured(signals[first:])[390 - first :]
    assert 0 < abs(whole - some).max() < 2e-6


@pytest.mark.parametrize("first", [2, 3, 4, 5])
def test_a_scan_goes_on_at_any_view_bit_by_bit(first):
    views = views_of(integrating(SETTING, *SHORT))
    whole, rest = (list(projections(views, lambda _, *both: np.array(both), True, begin)) for begin in (0, first))
    np.testing.assert_array_equal(rest, whole[first:])


def test_noise_of_later_views_is_linked_as_the_response_says():
    noise = np.random.default_rng(2).normal(size=(200, 1, 100, 100))
    found = measured(noise, Lag((0.3,), (2.0,)))[50:]
    h = Lag((0.3,), (2.0,)).response(60)
    for later in range(3):
        wanted = (h[later:] * h[: 60 - later]).sum()
        covariance = np.mean(found[later:] * found[: len(found) - later])
        assert covariance == pytest.approx(wanted, abs=5 * np.sqrt(2 / found.size))


def test_a_scan_has_it_in_its_views_and_expected_counts_training_and_test_views_apart(tmp_path):
    for name, more in {"plain": [], "lag": [SETTING]}.items():
        simulate(integrating("noise=false", *more, *SHORT), tmp_path / f"{name}.h5", keep_expected=True)
    with open_dataset(tmp_path / "plain.h5") as plain, open_dataset(tmp_path / "lag.h5") as late:
        signals = plain.load()
        wanted = np.concatenate([measured(signals[:4]), measured(signals[4:])])
        np.testing.assert_allclose(late.load(), wanted, rtol=1e-6)
        np.testing.assert_allclose(late.file["truth/expected"][()], wanted, rtol=1e-6)
        np.testing.assert_array_equal(late.flat, plain.flat)


def test_a_scan_depends_on_neither_threads_nor_what_else_is_kept(tmp_path):
    scan = integrating(SETTING, "effects.electronics.sigma=100", *SHORT)
    try:
        for threads, kept in ((1, False), (3, True)):
            set_threads(threads)
            simulate(scan, tmp_path / f"{threads}.h5", keep_expected=kept)
    finally:
        set_threads(None)
    with open_dataset(tmp_path / "1.h5") as one, open_dataset(tmp_path / "3.h5") as three:
        np.testing.assert_array_equal(one.load(), three.load())
        np.testing.assert_array_equal(one.dark, three.dark)


@pytest.mark.parametrize(
    ("fractions", "decays", "words"),
    [
        ((0.1,), (1.0, 2.0), "a decay for each fraction, got 1 fractions, 2 decays"),
        ((0.6, 0.6), (1.0, 2.0), "sum up to at most 0.9"),
        ((0.1,), (0.0,), "decays of lag must be positive"),
    ],
)
def test_impossible_lags_are_refused(fractions, decays, words):
    with pytest.raises(InputError, match=words):
        Lag(fractions, decays)


def test_counters_have_none():
    with pytest.raises(SceneError, match=r"effects\.lag - lag is not known of detectors that count photons"):
        counting(SETTING)


def test_sources_that_take_turns_have_none():
    lines = "{low: {type: lines, lines: {40: 10}}, high: {type: lines, lines: {80: 10}}}"
    with pytest.raises(SceneError, match="is known for sources that do not take turns"):
        integrating(SETTING, f"source={{type: switching, sources: {lines}}}")
