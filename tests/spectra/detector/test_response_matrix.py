import numpy as np
import pytest

from spectra.detector.detector import Detector, channels_between
from spectra.detector.pulse_height import PulseHeightDetector
from spectra.detector.response_matrix import ResponseMatrix
from spectra.energy.grid import Energies
from spectra.errors import InputError
from spectra.materials.material import Material

ENERGY = np.arange(10.0, 121.0)
DEPOSITED = np.arange(0.25, 130, 0.5)
THRESHOLDS = (20.0, 50.0, 80.0)


def test_a_table_of_channels_is_interpolated_and_not_normalised():
    matrix = np.stack([ENERGY / 100, 2 - ENERGY / 100, np.full(len(ENERGY), 0.5)], axis=1)
    detector = ResponseMatrix.of_channels(ENERGY, matrix, THRESHOLDS, 120)
    energies = Energies(np.array([20.0, 60.0, 120.0]), np.array([33.3, 77.7]))
    np.testing.assert_allclose(detector.response(energies), [[0.333, 0.777], [1.667, 1.223], [0.5, 0.5]])
    assert detector.response(energies).sum(axis=0).min() > 2


@pytest.mark.parametrize("per_keV", [False, True])
def test_a_matrix_of_pulses_gives_the_channels_of_the_detector_that_made_it(per_keV):
    sensor = Material("CdTe", composition="CdTe")
    edges = np.append(DEPOSITED - 0.25, 130.0)
    fine = PulseHeightDetector(channels_between(np.maximum(edges[20:-1], 1).tolist(), 140), sensor, 1.6, 4.7 / 2, True)
    pulses = np.zeros((len(ENERGY), len(DEPOSITED)))
    pulses[:, 20:] = (fine.absorption(ENERGY) * fine.pulses(ENERGY)).T
    table = ResponseMatrix.of_deposited(ENERGY, DEPOSITED, pulses * (2 if per_keV else 1), THRESHOLDS, 120, per_keV)
    own = PulseHeightDetector(channels_between(THRESHOLDS, 120), sensor, 1.6, 4.7 / 2, True)
    energies = Energies.from_edges(np.array([29.0, 31.0, 59.0, 61.0, 99.0, 101.0]))
    np.testing.assert_allclose(table.response(energies), own.response(energies), atol=1e-6)


def test_a_threshold_shares_the_bin_that_it_cuts():
    matrix = np.tile(np.eye(1, len(DEPOSITED), 40), (len(ENERGY), 1))  # pulses of 20.0 to 20.5 keV
    detector = ResponseMatrix.of_deposited(ENERGY, DEPOSITED, matrix, [10, 20.125], 120)
    np.testing.assert_allclose(detector.counts[0], [0.25, 0.75])


def test_an_ideal_detector_as_a_table_is_the_ideal_detector():
    ideal = Detector.photon_counting(THRESHOLDS, 120)
    at = Energies(np.append(ENERGY, 121.0), ENERGY)
    table = ResponseMatrix.of_channels(ENERGY, ideal.response(at).T, THRESHOLDS, 120)
    inside = Energies.from_edges(np.array([24.5, 25.5, 59.5, 60.5, 99.5, 100.5]))
    np.testing.assert_allclose(table.response(inside)[:, ::2], ideal.response(inside)[:, ::2], atol=1e-12)
    assert table.lowest == 19
    assert table.breaks[0] == 20


def bad(value):
    matrix = np.full((len(ENERGY), 3), 0.5)
    matrix[7, 1] = value
    return matrix


@pytest.mark.parametrize(
    ("energy", "matrix", "words"),
    [
        (ENERGY, bad(-0.1), "must be finite and not negative, got -0.1 in row 7, column 1"),
        (ENERGY, bad(np.nan), "got nan in row 7, column 1"),
        (ENERGY, bad(0.5).T, r"expected \(111, 3\), incident energies x channels: is it transposed\?"),
        (ENERGY, bad(0.5)[:, :2], "has shape"),
        (ENERGY[::-1], bad(0.5), "must ascend, but 119 follows 120 keV"),
        (ENERGY[:50], bad(0.5)[:50], "the response matrix ends at 59 keV, but the source at 120 keV"),
        (np.full(1, 60.0), bad(0.5)[:1], "at least two finite incident energies"),
    ],
)
@pytest.mark.wrong_types
def test_impossible_tables_are_refused(energy, matrix, words):
    with pytest.raises(InputError, match=words):
        ResponseMatrix.of_channels(energy, matrix, THRESHOLDS, 120)


def test_uneven_bins_of_deposited_energy_are_refused():
    with pytest.raises(InputError, match="evenly spaced, but their steps are from 1 to 3 keV"):
        ResponseMatrix.of_deposited(ENERGY, np.array([1.0, 2.0, 5.0]), np.ones((111, 3)), [20], 120)
