"""Energy-integrating detectors against printed absorptions and closed forms of compound Poisson sums."""

import numpy as np
import pytest

from spectra.detector.scintillator import SCINTILLATORS, EnergyIntegrating
from spectra.energy.grid import Energies
from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.source.source import Filter, Source

ENERGIES = np.array([20, 30, 40, 60, 80, 100, 120, 140], dtype=float)
ABSORBED = {
    "CsI": [0.997, 0.858, 0.993, 0.819, 0.548, 0.356, 0.240, 0.170],
    "GOS": [1, 1, 0.997, 1, 0.992, 0.931, 0.812, 0.679],
    "GOS screen": [0.964, 0.677, 0.410, 0.587, 0.343, 0.210, 0.137, 0.095],
}


@pytest.fixture(scope="module")
def source():
    return Source.tube(120, 1e5, 12, [Filter(Material("Al", composition="Al"), 2.5)])


@pytest.mark.parametrize("name", ABSORBED)
def test_usual_scintillators_absorb_as_tabulated_and_add_the_energy_of_each_photon(name):
    detector = EnergyIntegrating.behind(Source.monochromatic(150, 1), name)
    signal = [detector.response(Energies.single(energy))[0, 0] for energy in ENERGIES]
    tolerance = 0.01 if name == "GOS screen" else 2e-3  # the table's packing was a little different
    np.testing.assert_allclose(signal / ENERGIES, ABSORBED[name], atol=tolerance)


@pytest.mark.parametrize(("name", "edges"), [("CsI", 2), ("GOS", 1), ("CdWO4", 2)])
def test_k_edges_of_the_scintillator_are_breaks(source, name, edges):
    detector = EnergyIntegrating.behind(source, name)
    assert len(detector.breaks) == edges
    for edge in detector.breaks:
        below, above = (detector.response(Energies.single(edge + d))[0, 0] for d in (-0.1, 0.1))
        assert above > 1.01 * below or above > 0.99 * edge  # thick ones absorb everything on both sides


@pytest.mark.parametrize(("thickness", "ratio"), [(0.0, 0.890), (200.0, 0.936), (300.0, 0.942)])
def test_the_variance_is_that_of_a_compound_sum(source, thickness, ratio):
    detector = EnergyIntegrating.behind(source)
    energies, photons = source.sampled(source.grid(detector.lowest, 1000, detector.breaks))
    photons = photons * np.exp(-thickness * Material("water", composition="water").attenuation(energies.nodes))
    signal, variance = ((photons * of(energies)[0]).sum() for of in (detector.response, detector.variance))
    absorbed = (photons * detector.response(energies)[0] / energies.nodes).sum()
    # m1^2 / (m0 m2), as computed elsewhere for this spectrum and 0.6 mm of CsI.
    assert signal**2 / (absorbed * variance) == pytest.approx(ratio, abs=2e-3)


def test_nearly_all_of_the_signal_lies_in_the_channel(source):
    detector = EnergyIntegrating.behind(source)
    energies, photons = source.sampled(source.grid(1.0, 1000))
    signal = photons * detector.response(energies)[0]
    assert signal[energies.nodes < detector.lowest].sum() < 1e-6 * signal.sum()
    assert signal[energies.nodes < detector.lowest + 2].sum() > 1e-6 * signal.sum()
    assert detector.channels[0].upper == 120


def test_a_single_energy_lies_in_the_channel():
    assert EnergyIntegrating.behind(Source.monochromatic(60, 10)).lowest == 59


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"material": "NaI"}, "unknown scintillator 'NaI': choose from 'CsI'"),
        ({"thickness": 0.0}, "scintillator thickness must be positive and finite, got 0 mm"),
        ({"thickness": np.nan}, "scintillator thickness"),
        ({"material": Material("NaI", 3.67, "NaI")}, "a scintillator of NaI needs a thickness"),
    ],
)
def test_impossible_scintillators_are_refused(source, options, words):
    with pytest.raises(InputError, match=words):
        EnergyIntegrating.behind(source, **options)


def test_densities_are_not_those_of_crystals_where_grains_leave_gaps():
    assert SCINTILLATORS["CsI"].density < 4.51
    assert SCINTILLATORS["GOS screen"].density < SCINTILLATORS["GOS"].density
