"""Lines, bands and histograms: what they hold is what was asked for, on any grid."""

import numpy as np
import pytest

from spectra.energy.grid import Energies
from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.source.source import Filter, Source

ALUMINIUM = Material("aluminium", composition="Al")
COBALT = {14.41: 9.16, 122.06: 85.6, 136.47: 10.68}


def test_lines_keep_their_energies_and_shares():
    source = Source.of_lines(COBALT, 1000)
    assert source.photons == pytest.approx(1000, rel=1e-14)
    energies, photons = source.sampled(source.grid(20, 100))
    seen = photons > 0
    assert energies.nodes[seen] == pytest.approx([122.06, 136.47], rel=1e-12)
    assert photons[seen] == pytest.approx(np.array([85.6, 10.68]) / 105.44 * 1000, rel=1e-12)
    assert Source.of_lines(COBALT).photons == pytest.approx(105.44)


def test_lines_behind_a_filter_obey_beer_and_lambert():
    behind = Source.of_lines(COBALT).filtered(Filter(ALUMINIUM, 3.0))
    wanted = np.array(list(COBALT.values())) * np.exp(-3 * ALUMINIUM.attenuation(np.array(list(COBALT))))
    assert behind.line_photons == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize(("shape", "variance"), [("gaussian", 1 / (8 * np.log(2))), ("box", 1 / 12)])
@pytest.mark.parametrize("width", [0.01, 1.0, 8.0])
def test_a_band_has_its_centre_and_width(shape, variance, width):
    source = Source.band(60, width, 5e4, shape)
    edges = 60 + width * np.linspace(-2, 2, 4001)
    photons, mean = source.photons_in(edges)
    assert photons.sum() == pytest.approx(5e4, rel=1e-9)
    assert photons @ mean / photons.sum() == pytest.approx(60, rel=1e-12)
    assert photons @ (mean - 60) ** 2 / photons.sum() == pytest.approx(variance * width**2, rel=1e-3)
    highest = photons.max()
    half = edges[:-1][photons > highest / 2]
    assert half[-1] - half[0] == pytest.approx(width, rel=2e-3)


@pytest.mark.parametrize("count", [3, 40, 120, 1001])
def test_a_histogram_is_conserved_on_coarser_and_finer_bins(count):
    rng = np.random.default_rng(count)
    edges, photons = np.sort(rng.uniform(20, 120, 41)), rng.uniform(0.1, 1, 40)
    middle = (edges[:-1] + edges[1:]) / 2
    found, mean = Source.of_bins(edges, photons).photons_in(np.linspace(10, 130, count + 1))
    assert found.sum() == pytest.approx(photons.sum(), rel=1e-12)
    assert found @ mean == pytest.approx(photons @ middle, rel=1e-12)


def test_a_histogram_on_its_own_bins_is_itself():
    edges, photons = np.array([10.0, 20.5, 21.0, 60.0]), np.array([2.0, 0.0, 5.0])
    found, mean = Source.of_bins(edges, photons).photons_in(edges)
    assert found == pytest.approx(photons, rel=1e-12, abs=1e-12)
    assert mean == pytest.approx([15.25, 20.75, 40.5], rel=1e-12)


def test_a_histogram_ends_where_its_photons_end():
    source = Source.of_bins(np.arange(0.0, 151.0), np.where(np.arange(150) < 120, np.arange(150) >= 20, 0.0))
    assert (source.energy[0], source.maximum) == (20.0, 120.0)


def test_wide_bins_behind_a_filter_are_attenuated_energy_by_energy():
    source = Source.of_bins(np.array([20.0, 40.0, 100.0]), np.array([1.0, 3.0])).filtered(Filter(ALUMINIUM, 2.5))
    energy = np.linspace(20, 100, 800_001)
    middle = (energy[1:] + energy[:-1]) / 2
    density = np.where(middle < 40, 1 / 20, 3 / 60) * np.exp(-2.5 * ALUMINIUM.attenuation(middle))
    assert source.photons == pytest.approx(density.sum() * 1e-4, rel=1e-5)


def test_a_tube_without_a_number_of_photons_gives_them_per_area_and_charge():
    import spekpy

    fluence = spekpy.Spek(kvp=120, th=12, dk=0.1, physics="casim", z=100).get_flu()
    assert Source.tube(120, None).photons == pytest.approx(fluence, rel=2e-3)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: Source.of_lines({}), "at least one line"),
        (lambda: Source.of_lines({60.0: 0.0}), "positive weight, got 60: 0"),
        (lambda: Source.of_lines({60e3: 1.0}), "within 1 .. 800 keV"),
        (lambda: Source.band(60, 0, 1), "positive width"),
        (lambda: Source.band(3, 2, 1), "within 1 .. 800 keV, got 3 keV and a width of 2 keV"),
        (lambda: Source.band(60, 1, 1, "triangle"), "gaussian or box, got 'triangle'"),
        (lambda: Source.of_bins(np.array([1.0, 2, 3]), np.ones(3)), "2 energy bins need as many"),
        (lambda: Source.of_bins(np.array([1.0, 2, 3]), np.array([1, np.nan])), "finite and not negative"),
        (lambda: Source.of_bins(np.array([0.0, 2, 3]), np.ones(2)), "within 1 .. 800 keV, got 0 .. 3"),
    ],
)
def test_impossible_sources_are_refused(wrong, message):
    with pytest.raises(InputError, match=message):
        wrong()


def test_a_line_on_top_of_the_grid_is_counted():
    source = Source.of_lines({30.0: 1.0, 60.0: 2.0})
    energies = Energies.snapped(20, source.maximum, 16, (), source.line_energy)
    assert source.photons_in(energies.edges)[0].sum() == pytest.approx(3.0)
