"""Signals: closed forms, ranges, cycles, and tables that cannot be."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phantomgen.scene.dynamics.signals import Cardiac, GammaVariate, Respiratory, Sine, Table
from spectra.errors import InputError

TIMES = np.linspace(0.0, 40.0, 4001)


def test_gamma_variate_is_1_at_its_peak_and_has_the_area_of_its_closed_form():
    from scipy.special import gamma

    signal = GammaVariate(arrival=3.0, rise=4.0, shape=3.0)
    assert signal.values(np.array([0.0, 3.0, 7.0])) == pytest.approx([0, 0, 1])
    times = np.linspace(3, 203, 200_001)
    area = 4.0 * np.exp(3.0) * gamma(4.0) / 3.0**4
    assert np.trapezoid(signal.values(times), times) == pytest.approx(area, rel=1e-6)


@given(exponent=st.integers(1, 6), start=st.floats(-2, 2))
def test_even_breathing_has_the_mean_of_a_power_of_a_sine(exponent, start):
    from math import comb

    signal = Respiratory(4.0, exponent, start)
    values = signal.values(np.arange(4000) * 0.01)
    assert values.min() >= 0
    assert values.max() <= 1
    assert values.mean() == pytest.approx(comb(2 * exponent, exponent) / 4**exponent, abs=1e-6)


def test_breaths_that_differ_join_without_a_step_and_keep_their_mean_period():
    signal = Respiratory(4.0, 2, period_deviation=0.1, amplitude_deviation=0.1, seed=7)
    times = np.linspace(0, 4000, 400_001)
    values, cycles = signal.values(times), signal.cycles(times)
    assert np.abs(np.diff(values)).max() < 0.02
    breaths = (np.diff(cycles) < -0.5).sum()
    assert breaths == pytest.approx(1000, abs=15)
    assert np.array_equal(values, Respiratory(4.0, 2, 0.0, 0.1, 0.1, 7).values(times))
    assert not np.array_equal(values, Respiratory(4.0, 2, 0.0, 0.1, 0.1, 8).values(times))


def test_heart_contracts_relaxes_and_rests():
    signal = Cardiac(period=1.0, systole=0.4, relaxation=0.2)
    assert signal.values(np.array([0.0, 0.2, 0.4, 0.5, 0.6, 0.9])) == pytest.approx([0, 0.5, 1, 0.5, 0, 0], abs=1e-12)


@pytest.mark.parametrize(
    "signal", [Sine(period=3.0, start=0.2), Respiratory(3.0), Cardiac(period=3.0), Table((0, 1), (0, 1), 3.0)]
)
def test_signals_that_repeat_have_equal_values_at_equal_positions_of_the_cycle(signal):
    assert signal.values(TIMES) == pytest.approx(signal.values(TIMES + 3.0), abs=1e-9)
    cycles = signal.cycles(TIMES)
    assert cycles.min() >= 0
    assert cycles.max() <= 1


def test_a_table_is_linear_and_constant_outside():
    assert Table((1.0, 3.0), (0.0, 4.0)).values(np.array([0.0, 2.0, 9.0])) == pytest.approx([0, 2, 4])
    assert Table((1.0, 3.0), (0.0, 4.0)).cycles(TIMES) is None


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Table((0.0, 1.0), (0.0,)), "equally many, got 2 and 1"),
        (lambda: Table((0.0, 0.0), (0.0, 1.0)), "must ascend"),
        (lambda: Table((0.0, 2.0), (0.0, 1.0), 1.5), "less than its period of 1.5 s"),
        (lambda: Cardiac(period=1.0, systole=0.8, relaxation=0.4), "at most 1, got 0.8 and 0.4"),
    ],
)
def test_impossible_signals_are_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()
