"""Energy-integrating detectors against printed absorptions and closed forms of compound Poisson sums."""

import numpy as np
import pytest

from spectra.detector.scintillator import SCINTILLATORS, EnergyIntegrating, energy_groups
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


@pytest.mark.parametrize("thickness", [0.0, 200.0, 300.0])
def test_groups_have_the_mean_of_the_signal_and_nearly_its_higher_moments(source, thickness):
    detector = EnergyIntegrating.behind(source)
    energies, photons = source.sampled(source.grid(detector.lowest, 1000, detector.breaks))
    signal = photons * detector.response(energies)[0]
    rows, quanta = energy_groups(energies.nodes, signal)
    passed = (
        np.exp(-thickness * Material("water", composition="water").attenuation(energies.nodes)) if thickness else 1.0
    )
    groups = (rows * passed).sum(axis=1)
    # The cumulant of order n of a compound Poisson sum is the sum of E^n over the absorbed photons.
    exact = [(signal * passed * energies.nodes**power).sum() for power in range(3)]
    found = [(groups * quanta**power).sum() for power in range(3)]
    assert found[0] == pytest.approx(exact[0], rel=1e-12)
    assert found[1] == pytest.approx(exact[1], rel=1e-12 if thickness == 0 else 0.005)
    assert found[2] == pytest.approx(exact[2], rel=0.01)
    # m1^2 / (m0 m2), as computed elsewhere for this spectrum and 0.6 mm of CsI.
    m0 = (photons * passed * detector.response(energies)[0] / energies.nodes).sum()
    assert exact[0] ** 2 / (m0 * exact[1]) == pytest.approx(
        {0.0: 0.890, 200.0: 0.936, 300.0: 0.942}[thickness], abs=2e-3
    )


def test_nearly_all_of_the_signal_lies_in_the_channel(source):
    detector = EnergyIntegrating.behind(source)
    energies, photons = source.sampled(source.grid(1.0, 1000))
    signal = photons * detector.response(energies)[0]
    assert signal[energies.nodes < detector.lowest].sum() < 1e-6 * signal.sum()
    assert signal[energies.nodes < detector.lowest + 2].sum() > 1e-6 * signal.sum()
    assert detector.channels[0].upper == 120


def test_a_single_energy_is_one_group():
    rows, quanta = energy_groups(np.array([60.0]), np.array([5.0]))
    assert rows.tolist() == [[5.0]]
    assert quanta.tolist() == [60.0]
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
