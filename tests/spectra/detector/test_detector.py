import numpy as np
import pytest

from spectra.detector.detector import Detector
from spectra.energy.grid import Energies
from spectra.errors import InputError
from spectra.materials.material import Material


def test_absorption_of_cadmium_telluride_is_as_tabulated(detector):
    expected = [1, 1, 1, 0.998, 0.941, 0.791, 0.624, 0.488]
    energies = np.array([20, 30, 40, 60, 80, 100, 120, 140], dtype=float)
    np.testing.assert_allclose(detector.absorption(energies), expected, atol=1e-3)


def test_channels_are_disjoint_and_complete(detector):
    energies = Energies.snapped(10, 150, 300, detector.breaks)
    response = detector.response(energies)
    assert ((response > 0).sum(axis=0) == (energies.nodes > 20)).all()
    seen = energies.nodes > 20
    np.testing.assert_allclose(response.sum(axis=0)[seen], detector.absorption(energies.nodes)[seen], rtol=1e-13)


def test_a_threshold_counts_from_itself_on(detector):
    at_threshold = Energies(np.array([63.3, 63.32]), np.array([63.3]))
    for energies in (at_threshold, Energies.single(63.3)):
        np.testing.assert_array_equal(np.flatnonzero(detector.response(energies)[:, 0]), [2])
        np.testing.assert_allclose(detector.response(energies)[2], detector.absorption(np.array([63.3])), rtol=1e-12)


def test_a_bin_across_a_threshold_is_shared():
    detector = Detector.photon_counting([20, 50], top=100)
    response = detector.response(Energies.from_edges(np.array([40.0, 60.0])))
    np.testing.assert_allclose(response[0], response[1])


def test_names_breaks_and_sensor(detector):
    assert detector.names == ("bin0", "bin1", "bin2", "bin3")
    assert detector.thresholds == (20, 45, 63.3, 80)
    assert len(detector.breaks) == 6
    silicon = Detector.photon_counting([20], top=100, material=Material("silicon", composition="Si"), thickness=0.5)
    assert silicon.absorption(np.array([100.0]))[0] == pytest.approx(0.02, abs=2e-3)


@pytest.mark.parametrize(
    ("thresholds", "options", "words"),
    [
        ([20, 63.3, 45], {}, "bin1 would reach from 63.3 to 45 keV"),
        ([20, 20], {}, "ascend"),
        ([20, 150], {}, "channel bin1 starts at 150 keV and sees no photons"),
        ([], {}, "at least one threshold"),
        ([float("nan")], {}, "finite"),
        ([20], {"thickness": 0.0}, "thickness"),
        ([20], {"material": "CdTf"}, "unknown material"),
    ],
)
def test_impossible_detectors_are_refused(thresholds, options, words):
    with pytest.raises(InputError, match=words):
        Detector.photon_counting(thresholds, top=140, **options)
