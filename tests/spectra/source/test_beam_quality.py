import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spectra.energy.grid import Energies
from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.source.beam_quality import (
    ALUMINIUM,
    COPPER,
    BeamQuality,
    air_absorption,
    attenuating_thickness,
    effective_energy,
    half_value_layers,
    kerma_per_fluence,
    mean_energy,
)
from spectra.source.source import Filter, Source

NONE = np.empty(0)
TRIANGLE = Source(np.array([20.0, 70.0, 140.0]), np.array([0.0, 100.0, 0.0]), NONE, NONE, 140.0)
TIN = Material("tin", composition="Sn")


@given(st.floats(2, 400))
def test_one_energy_has_the_half_value_layers_ln_2_over_mu(energy):
    source = Source.monochromatic(energy, 1e5)
    expected = np.log(2) / ALUMINIUM.attenuation(np.array([energy]))[0]
    assert half_value_layers(source) == pytest.approx((expected, expected), rel=1e-11)
    quality = BeamQuality.of(source)
    assert quality.effective_energy == energy
    assert quality.mean_energy == pytest.approx(energy, rel=1e-15)
    assert quality.homogeneity == pytest.approx(1, rel=1e-11)


def test_two_lines_are_halved_where_their_exponentials_say():
    energy, photons = np.array([40.0, 100.0]), np.array([3.0, 1.0])
    source = Source(NONE, NONE, energy, photons, 100.0)
    kerma, mu = photons * energy * air_absorption(energy), COPPER.attenuation(energy)
    for fraction in (0.9, 0.5, 0.25, 1e-6):
        t = attenuating_thickness(source, COPPER, fraction)
        assert kerma @ np.exp(-mu * t) / kerma.sum() == pytest.approx(fraction, rel=1e-11)
    assert mean_energy(source) == 55.0


def test_layers_behind_a_k_edge_agree_with_brute_force(tube):
    # An edge of the layer's own inside the spectrum; sums over 0.01 keV bins in place of Gauss nodes.
    energies, photons = tube.sampled(Energies.snapped(1.0, 140.0, 13900, (*tube.breaks, 29.2001)))
    kerma, mu = photons * energies.nodes * air_absorption(energies.nodes), TIN.attenuation(energies.nodes)
    for fraction in (0.5, 0.25):
        t = attenuating_thickness(tube, TIN, fraction)
        assert kerma @ np.exp(-mu * t) / kerma.sum() == pytest.approx(fraction, rel=1e-5)


def test_a_source_of_few_corners_is_integrated_as_finely_as_one_of_many():
    corners = np.unique(np.append(np.linspace(20, 140, 1201), 70.0))
    fine = Source(corners, TRIANGLE.density_at(corners), NONE, NONE, 140.0)
    assert half_value_layers(TRIANGLE) == pytest.approx(half_value_layers(fine), rel=1e-7)
    assert kerma_per_fluence(TRIANGLE) == pytest.approx(kerma_per_fluence(fine), rel=1e-7)
    # Of two triangles of bases 50 and 70 with a common height: thirds of their widths from 70 keV.
    assert mean_energy(TRIANGLE) == pytest.approx((50 * (70 - 50 / 3) + 70 * (70 + 70 / 3)) / 120, rel=1e-12)


def test_a_filter_hardens_a_beam_and_its_half_value_layers_add_up(tube):
    first, second = half_value_layers(tube)
    behind = tube.filtered(Filter(ALUMINIUM, first))
    assert half_value_layers(behind)[0] == pytest.approx(second, rel=1e-5)
    assert first < second
    assert mean_energy(tube) < mean_energy(behind)


def test_the_effective_energy_attenuates_like_the_beam(tube):
    energy = effective_energy(tube)
    assert half_value_layers(Source.monochromatic(energy, 1.0))[0] == pytest.approx(half_value_layers(tube)[0])
    # Tin attenuates as much at several energies, below and above its edge: the one near the mean is meant.
    assert 35 < effective_energy(tube, TIN) < mean_energy(tube)


@pytest.mark.parametrize(("energy", "printed"), [(20, 0.5389), (60, 0.03041), (100, 0.02325), (3, 161.4), (5, 39.31)])
def test_air_kerma_of_one_photon_is_energy_times_absorption(energy, printed):
    # NIST SRD 126, mass energy-absorption coefficient of dry air [cm^2/g].
    assert air_absorption(np.array([float(energy)]))[0] == pytest.approx(printed, rel=1e-12)
    joule, square_metre_per_kg = energy * 1.602176634e-16, 0.1 * printed
    assert kerma_per_fluence(Source.monochromatic(energy, 7.0)) == pytest.approx(joule * square_metre_per_kg * 1e6)


@pytest.mark.parametrize("fraction", [0.0, 1.0, -1.0, np.nan])
def test_impossible_fractions_are_refused(tube, fraction):
    with pytest.raises(InputError, match="between 0 and 1"):
        attenuating_thickness(tube, ALUMINIUM, fraction)


@pytest.mark.parametrize("energy", [0.5, 801.0, np.nan])
def test_air_is_known_from_1_to_800_kev(energy):
    with pytest.raises(InputError, match="1 to 800 keV"):
        air_absorption(np.array([float(energy)]))
