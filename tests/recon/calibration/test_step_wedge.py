"""Calibration behind a step wedge: values, uncertainties over repeated noise, and what cannot be separated.

Counts come from SpekPy at the very voltage and from a grid of 4000 bins, not from the model that is fitted.
"""

from dataclasses import replace

import numpy as np
import pytest

from recon.calibration.scoring import Likelihood, inverse, maximise
from recon.calibration.step_wedge import StepWedge, WedgeModel, with_counts
from spectra.channel_model import ChannelModel, Tube
from spectra.detector.detector import channels_between
from spectra.detector.pulse_height import PulseHeightDetector
from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.source.source import Filter, Source

AL, COPPER, CDTE = (Material(name, None, name) for name in ("Al", "Cu", "CdTe"))
PMMA = Material("PMMA", 1.18, "C5H8O2")
TRUE = np.array([121.3, 3.1, 25.0, 45.0, 63.3, 80.0, 6.0])
START = np.array([120.0, 2.5, 25.5, 44.0, 64.0, 79.0, 5.0])
STEPS = ((2, 5, 10, 20, 40), (0.2, 0.5, 1, 2, 4), (20, 50, 100, 200))  # mm of aluminium, copper and PMMA
LENGTHS = np.array([np.zeros(3), *(t * np.eye(3)[i] for i, steps in enumerate(STEPS) for t in steps)])
NONE = np.full(7, np.inf)


@pytest.fixture(scope="module")
def mean():
    source = Source.tube(121.3, None, 12.0, (Filter(AL, 3.1),))
    detector = PulseHeightDetector(channels_between(TRUE[2:-1].tolist(), 121.3), CDTE, 1.6, 6.0)
    energies, photons = source.sampled(source.grid(8.0, 4000, detector.breaks))
    mu = np.stack([material.attenuation(energies.nodes) for material in (AL, COPPER, PMMA)])
    counts = np.exp(-LENGTHS @ mu) @ (photons * detector.response(energies)).T
    return counts * 4e6 / counts[0].sum()


@pytest.fixture(scope="module")
def model(mean):
    tube = Tube()
    grid = ChannelModel.grid(tube, (AL, COPPER, CDTE), 8.0, 140.0)
    wedge = StepWedge((AL, COPPER, PMMA), LENGTHS, mean)
    return WedgeModel(ChannelModel(tube, AL, CDTE, 1.6, grid), wedge, START, np.ones(7, bool))


def test_counts_without_noise_give_the_true_values(model):
    found = model.fit(NONE)
    assert (np.abs(found.values - TRUE) < 0.05 * found.uncertainty).all()
    assert found.deviance < 0.01
    assert model.misfit(found) is None


def test_score_is_the_derivative_of_the_likelihood(model, mean):
    noisy = with_counts(model, np.random.default_rng(3).poisson(mean).astype(float))
    found = noisy.likelihood(START)
    for i, step in enumerate((0.5, 0.002, 0.02, 0.02, 0.02, 0.02, 0.02)):
        up, down = START.copy(), START.copy()
        up[i], down[i] = START[i] + step, START[i] - step
        slope = -(noisy.likelihood(up).deviance - noisy.likelihood(down).deviance) / (4 * step)
        assert found.score[i] == pytest.approx(slope, rel=2e-2, abs=2e-3 * np.sqrt(found.information[i, i]) * 1e3)


@pytest.mark.slow
def test_uncertainty_is_the_spread_over_repeated_noise(model, mean):
    rng, values, sigmas, deviances = np.random.default_rng(0), [], [], []
    for _ in range(200):
        found = with_counts(model, rng.poisson(mean).astype(float)).fit(NONE)
        values.append(found.values)
        sigmas.append(found.uncertainty)
        deviances.append(found.deviance)
    spread, stated = np.std(values, axis=0, ddof=1), np.mean(sigmas, axis=0)
    np.testing.assert_allclose(spread / stated, 1.0, atol=0.2)  # 4 standard deviations of the ratio, 1 / sqrt(400)
    covered = (np.abs(np.array(values) - TRUE) < np.array(sigmas)).mean(axis=0)
    np.testing.assert_allclose(covered, 0.683, atol=0.13)  # 4 sqrt(0.683 * 0.317 / 200)
    assert np.mean(deviances) == pytest.approx(model.freedom, abs=4 * np.sqrt(2 * model.freedom / 200))


def test_thin_aluminium_does_not_separate_voltage_and_filter_in_one_channel(model, mean):
    open_counts = mean.sum(axis=1, keepdims=True)
    thin = LENGTHS[:3, :1]
    start, free = np.array([120.0, 2.5, 25.0, 6.0]), np.array([True, True, False, False])
    one = WedgeModel(model.model, StepWedge((AL,), thin, open_counts[:3]), start, free)
    found = one.fit(np.full(2, np.inf))
    sentence = found.inseparable(one.names, one.units)
    assert sentence is not None
    assert "voltage and filter" in sentence
    assert "prior" in sentence
    known = one.fit(np.array([0.5, np.inf]))
    assert known.inseparable(one.names, one.units) is None
    assert known.uncertainty[0] < 0.5 < found.uncertainty[0]


def test_parameters_that_counts_do_not_determine_have_infinite_uncertainty(model, mean):
    start, free = np.array([120.0, 2.5, 25.0, 6.0]), np.array([True, True, True, False])
    one = WedgeModel(model.model, StepWedge((AL,), LENGTHS[:3, :1], mean[:3].sum(axis=1, keepdims=True)), start, free)
    found = one.fit(np.full(3, np.inf))  # two transmissions, three parameters
    assert np.isinf(found.uncertainty).all()
    assert "unknown together" in str(found.inseparable(one.names, one.units))


def test_a_common_gain_tells_more(model):
    free = np.array([True, True, *[False] * 5])
    own = replace(model, free=free, start=np.array([*START[:2], *TRUE[2:]]))
    common = replace(own, wedge=replace(own.wedge, common_gain=True))
    sigmas = [m.fit(np.full(2, np.inf)).uncertainty for m in (own, common)]
    assert (sigmas[1] < 0.5 * sigmas[0]).all()


def test_wrong_fixed_values_are_noticed(model):
    free = np.array([True, True, *[False] * 5])
    wrong = replace(model, free=free)
    sentence = wrong.misfit(wrong.fit(np.full(2, np.inf)))
    assert sentence is not None
    assert "does not explain the counts" in sentence


def test_a_resolution_of_zero_cannot_be_free(model):
    with pytest.raises(InputError, match="start above 0 keV"):
        replace(model, start=np.array([*START[:-1], 0.0])).fit(NONE)


def test_counts_that_are_none_are_refused(model):
    for bad in (-1.0, np.nan):
        counts = model.wedge.counts.copy()
        counts[2, 1] = bad
        with pytest.raises(InputError, match="finite and not negative"):
            with_counts(model, counts)


def test_inverse_of_a_singular_information_is_infinite():
    assert np.isinf(inverse(np.ones((2, 2)))).all()
    assert np.isinf(inverse(np.diag([1.0, 0.0]))).all()
    np.testing.assert_allclose(inverse(np.diag([1.0, 4e8])), np.diag([1.0, 2.5e-9]))


def test_priors_shift_a_linear_model_as_in_closed_form():
    information, peak = np.array([[4.0, 1.0], [1.0, 2.0]]), np.array([1.0, -2.0])

    def quadratic(values):
        away = peak - values
        return Likelihood(float(away @ information @ away), information @ away, information)

    start, prior = np.array([3.0, 0.5]), np.array([0.5, 2.0])
    found = maximise(quadratic, start, prior)
    both = information + np.diag(1 / prior**2)
    np.testing.assert_allclose(found.values, np.linalg.solve(both, information @ peak + start / prior**2), atol=5e-3)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(both))
