"""Sensitivities of a `ChannelModel` against SpekPy and detectors on a much finer grid."""

import numpy as np
import pytest

from spectra.channel_model import ChannelModel, Tube, parameter_names
from spectra.detector.detector import Detector, channels_between
from spectra.detector.pulse_height import PulseHeightDetector
from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.source.source import Filter, Source

AL, CDTE, COPPER = (Material(name, None, name) for name in ("Al", "CdTe", "Cu"))
THRESHOLDS = (25.0, 45.0, 63.3, 80.0)


@pytest.fixture(scope="module")
def model():
    tube = Tube(filters=(Filter(COPPER, 0.1),))
    return ChannelModel(tube, AL, CDTE, 1.6, ChannelModel.grid(tube, (AL, CDTE, COPPER), 8.0, 130.0))


@pytest.mark.parametrize("resolution", [0.0, 6.0])
def test_counts_agree_with_a_fine_grid_at_a_broken_voltage(model, resolution):
    found = model.weights(np.array([121.3, 3.1, *THRESHOLDS, resolution]))
    source = Source.tube(121.3, None, 12.0, (Filter(COPPER, 0.1), Filter(AL, 3.1)))
    channels = channels_between(THRESHOLDS, 121.3)
    detector = PulseHeightDetector(channels, CDTE, 1.6, resolution) if resolution else Detector(channels, CDTE, 1.6)
    energies, photons = source.sampled(source.grid(8.0, 4000, detector.breaks))
    exact = photons * detector.response(energies)
    for thickness in (0.0, 20.0):  # of aluminium in the beam
        mu = [AL.attenuation(nodes) for nodes in (model.energies.nodes, energies.nodes)]
        ours, fine = (w @ np.exp(-thickness * m) for w, m in ((found, mu[0]), (exact, mu[1])))
        np.testing.assert_allclose(ours, fine, rtol=2e-4)


def test_source_and_detector_are_those_of_the_weights(model):
    values = np.array([121.0, 2.0, *THRESHOLDS, 0.0])
    source, detector = model.source(values), model.detector(values, 121.0)
    assert detector.channels[-1].upper == 121.0
    total = (source.photons_in(model.energies.edges)[0] * detector.response(model.energies)).sum(axis=1)
    np.testing.assert_allclose(model.weights(values).sum(axis=1), total, rtol=2e-4)


def test_thresholds_that_do_not_ascend_are_refused(model):
    with pytest.raises(InputError, match="thresholds must ascend"):
        model.weights(np.array([121.0, 2.0, 25.0, 65.0, 63.3, 80.0, 0.0]))


def test_names():
    assert parameter_names(2) == ("voltage", "filter", "threshold_0", "threshold_1", "resolution")
