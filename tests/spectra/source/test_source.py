import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from spectra.elements.attenuation import edge_energy
from spectra.energy.grid import Energies
from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.source.source import Filter, Source

ALUMINIUM = Material("aluminium", composition="Al")
TIN = Material("tin", composition="Sn")

# NIST SRD 126: mass energy-absorption coefficient of dry air [cm^2/g].
AIR_ENERGY = [10, 15, 20, 30, 40, 50, 60, 80, 100, 150]
AIR_ABSORPTION = [4.742, 1.334, 0.5389, 0.1537, 0.06833, 0.04098, 0.03041, 0.02407, 0.02325, 0.02496]


def half_value_layer(source):
    """First half-value layer of the air kerma [mm Al]."""
    energies, photons = source.sampled(Energies.from_edges(np.arange(10, source.maximum + 0.05, 0.1)))
    air = np.exp(CubicSpline(np.log(AIR_ENERGY), np.log(AIR_ABSORPTION))(np.log(energies.nodes)))
    kerma, mu = photons * energies.nodes * air, ALUMINIUM.attenuation(energies.nodes)
    return brentq(lambda t: kerma @ np.exp(-mu * t) - kerma.sum() / 2, 0.1, 30)


def mean_energy(source):
    photons, mean = source.photons_in(np.array([1.0, source.maximum]))
    assert photons[0] == pytest.approx(source.photons, rel=1e-12)
    return mean[0]


def test_beam_quality_is_that_of_spekpy(tube):
    # SpekPy casim at 140 kVp behind 2.5 mm Al, with NIST attenuation of aluminium: 4.981 mm and 59.19 keV.
    assert half_value_layer(tube) == pytest.approx(4.981, rel=0.01)
    assert mean_energy(tube) == pytest.approx(59.19, abs=0.3)
    behind_tin = tube.filtered(Filter(TIN, 0.5))
    assert mean_energy(behind_tin) > 85


def test_spekpy_itself_agrees_bin_by_bin(tube):
    import spekpy

    theirs = spekpy.Spek(kvp=140, th=12, dk=0.5, physics="casim", mu_data_source="nist").filter("Al", 2.5)
    middle, fluence = theirs.get_spectrum(flu=True, diff=False)
    edges = np.append(middle - 0.25, 140.0)
    ours = tube.photons_in(edges)[0]
    kept = (middle > 30) & (np.abs(middle - edge_energy("W")) > 1)
    fluence *= ours[kept].sum() / fluence[kept].sum()
    np.testing.assert_allclose(ours[kept], fluence[kept], rtol=0.02)


def test_photons_are_those_asked_for_and_rebinning_conserves_them(tube):
    assert tube.photons == pytest.approx(2e5, rel=1e-12)
    fine, fine_mean = tube.photons_in(np.linspace(20, 140, 4801))
    coarse, coarse_mean = tube.photons_in(np.linspace(20, 140, 13))
    np.testing.assert_allclose(fine.reshape(12, 400).sum(axis=1), coarse, rtol=1e-11)
    np.testing.assert_allclose((fine * fine_mean).reshape(12, 400).sum(axis=1), coarse * coarse_mean, rtol=1e-11)


@given(st.floats(2, 139), st.floats(0.01, 1))
def test_bin_integrals_are_those_of_the_straight_lines(low, width):
    triangle = Source(np.array([0.0, 70.0, 140.0]), np.array([0.0, 70.0, 0.0]), np.empty(0), np.empty(0), 140.0)
    high = low + width
    photons, mean = triangle.photons_in(np.array([low, high]))
    parts = [(min(low, 70), min(high, 70), 0, 1), (max(low, 70), max(high, 70), 140, -1)]
    count = sum(c * (b - a) + s * (b**2 - a**2) / 2 for a, b, c, s in parts)
    moment = sum(c * (b**2 - a**2) / 2 + s * (b**3 - a**3) / 3 for a, b, c, s in parts)
    assert photons[0] == pytest.approx(count, rel=1e-7)
    assert mean[0] == pytest.approx(moment / count, rel=1e-7)


def test_density_jumps_at_the_tungsten_edge_and_lines_stay_apart(tube):
    edge = edge_energy("W")
    assert edge in tube.breaks
    below, above = tube.density_at(np.array([edge - 1e-7, edge]))
    assert 0.7 < above / below < 0.9
    share = tube.line_photons.sum() / tube.photons
    assert 0.08 < share < 0.13
    assert np.abs(tube.line_energy - 59.32).min() < 0.06


def test_a_filter_attenuates_by_beer_lambert_and_adds_its_edge(tube):
    behind = tube.filtered(Filter(TIN, 0.5))
    assert edge_energy("Sn") in behind.breaks
    energy = np.array([28.0, 60.02, 100.0])
    expected = tube.density_at(energy) * np.exp(-0.5 * TIN.attenuation(energy))
    np.testing.assert_allclose(behind.density_at(energy), expected, rtol=1e-3)
    jump = behind.density_at(np.array([edge_energy("Sn") - 1e-7, edge_energy("Sn")]))
    assert jump[1] < 1e-4 * jump[0]


def test_gauss_nodes_and_bins_count_the_same_photons(tube):
    gauss = Energies.gauss_legendre(20, 140, 12, tube.breaks, tube.line_energy)
    same, photons = tube.sampled(gauss)
    assert same is gauss
    assert photons.sum() == pytest.approx(tube.photons_in(np.array([20.0, 140.0]))[0][0], rel=1e-5)


def test_a_monochromatic_source_has_one_energy_everywhere():
    source = Source.monochromatic(60, 1e5)
    energies, photons = source.sampled(source.grid(20, 128, (45, 63.3)))
    np.testing.assert_array_equal(energies.nodes, [60])
    np.testing.assert_allclose(photons, [1e5])
    # ... on any grid that holds it, also on an edge.
    for edges in ([20, 140], [20, 60], [60, 140], [20, 60, 140]):
        counts, mean = source.photons_in(np.array(edges, dtype=float))
        assert counts.sum() == pytest.approx(1e5)
        assert mean[counts > 0] == 60


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Source.tube(5, 1e5), "10 to 500 kV, got 5"),
        (lambda: Source.tube(80, 1e5, anode="molybdenum"), "10 to 50 kV"),
        (lambda: Source.tube(120, 1e5, angle=0), "5 .. 25 degrees"),
        (lambda: Source.tube(float("nan"), 1e5), "10 to 500 kV"),
        (lambda: Source.tube(120, 1e5, anode="cheese"), "unknown anode"),
        (lambda: Filter(ALUMINIUM, -1.0), "not negative"),
        (lambda: Filter(ALUMINIUM, float("inf")), "finite"),
        (lambda: Source.monochromatic(60, 0), "must be positive"),
        (lambda: Source.monochromatic(0.1, 1e5), "1 .. 800 keV"),
        (lambda: Source.monochromatic(60, 1e5).filtered(Filter(Material("lead", composition="Pb"), 100)), "absorb all"),
    ],
)
def test_impossible_sources_are_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()


@pytest.mark.parametrize("first", [KeyboardInterrupt, OSError])
def test_an_interrupt_while_tables_are_read_stays_one(monkeypatch, first):
    from spectra.source import tube

    def spek(**_):
        try:
            try:
                raise first
            except BaseException:
                raise Exception("no JSON")  # noqa: B904
        except Exception:
            raise Exception("error in loading state")  # noqa: B904

    monkeypatch.setattr(tube.spekpy, "Spek", spek)
    expected = KeyboardInterrupt if first is KeyboardInterrupt else Exception
    with pytest.raises(expected) as caught:
        tube.unfiltered_tube(61.0, 12.0)
    assert type(caught.value) is expected
