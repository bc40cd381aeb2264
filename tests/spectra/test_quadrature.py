"""Energy nodes by tolerance, and the hard cases that belong to energies."""

import numpy as np
import pytest

from spectra.basis.basis import Basis, BasisFunction
from spectra.detector.detector import Channel, Detector
from spectra.energy.grid import Energies
from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.quadrature import RULES, Integrand, cheapest, fine, gauss, log_error, midpoint, snapped
from spectra.source.source import Filter, Source

WATER, BONE = Material("water", composition="water"), Material("bone", composition="Bone, Cortical (ICRP)")
IODINE, TITANIUM = Material("iodine", composition="I"), Material("titanium", composition="Ti")
MATERIALS = (WATER, IODINE, BONE, TITANIUM)
HIGH = np.array([400.0, 0.2027, 50.0, 5.0])


def scintillator(material="CsI", density=3.6, thickness=0.6):
    """One channel that counts whatever is absorbed, from 20 keV on."""
    return Detector((Channel("all", 20.0, 150.0),), Material(material, density, material), thickness)


@pytest.fixture(scope="module")
def tube_120():
    return Source.tube(120, 1e5, 12, [Filter(Material("Al", composition="Al"), 2.5)])


@pytest.fixture(scope="module")
def four(tube_120):
    return Integrand(tube_120, scintillator(), MATERIALS, 20.0)


def truth_of(integrand, rays, step=0.002):
    """Log projection by brute force: bins of 2 eV with their own photons, nothing shared but source and curves."""
    lines = integrand.source.line_energy
    around = [*(lines - 1e-4), *(lines + 1e-4), *integrand.breaks]
    edges = np.unique([*np.arange(integrand.low, integrand.source.maximum, step), *around, integrand.source.maximum])
    photons, mean = integrand.source.photons_in(edges)
    weights = photons * integrand.detector.response(Energies(edges, mean))[0]
    exponents = -rays @ integrand.at(mean)
    shift = exponents.max(axis=1, keepdims=True)
    return -(np.log(np.exp(exponents - shift) @ weights) + shift[:, 0]) + np.log(weights.sum())


def test_the_fine_grid_is_the_integral(four):
    rays = np.random.default_rng(0).random((12, 4)) * HIGH
    np.testing.assert_allclose(fine(four).log_projection(rays)[:, 0], truth_of(four, rays), atol=2e-8)
    assert fine(four).open_beam == pytest.approx(four.open_beam)


def test_the_midpoint_rule_fails_as_published_models_do(four):
    error = log_error(midpoint(four, 64, 140.0), fine(four), 0 * HIGH, HIGH)
    assert 0.05 < error < 0.12


@pytest.mark.parametrize("count", [32, 128])
def test_snapping_converges_with_second_order(four, count):
    coarse, twice = (log_error(snapped(four, 100 / n), fine(four), 0 * HIGH, HIGH) for n in (count, 4 * count))
    assert twice < coarse / 8


@pytest.mark.parametrize(("most", "tolerance"), [(16, 1e-3), (32, 5e-5)])
def test_few_free_nodes_do(four, most, tolerance):
    found = cheapest(four, 0 * HIGH, HIGH, tolerance, ("compressed",))
    assert len(found) <= most
    assert (found.transmission.weights > 0).all()
    assert found.error <= tolerance
    np.testing.assert_allclose(found.transmission.open_beam, four.open_beam, rtol=tolerance)


@pytest.mark.parametrize("rules", [("gauss",), ("snapped", "gauss"), RULES])
def test_the_promise_holds_on_rays_that_nobody_saw(tube_120, rules):
    basis = Basis((BasisFunction("photoelectric"), BasisFunction("compton"), BasisFunction("element", element="I")))
    detector = Detector.photon_counting([25, 33.2, 60], 120)
    integrand, high = Integrand(tube_120, detector, basis, 25.0), np.array([0.5, 6.0, 1.0])
    found = cheapest(integrand, 0 * high, high, 1e-4, rules)
    rays = np.random.default_rng(7).random((3000, 3)) * high
    error = np.abs(found.transmission.log_projection(rays) - fine(integrand).log_projection(rays)).max()
    assert error <= 1.2e-4
    assert found.error <= 1e-4
    assert found.rule in rules
    assert found.transmission.channel_names == detector.names
    assert repr(found).startswith(f"Quadrature({found.rule}, {len(found)} nodes")


def test_more_rules_never_cost_more_nodes(tube_120):
    two = Integrand(tube_120, scintillator(), MATERIALS[:2], 20.0)
    few, many = (cheapest(two, np.zeros(2), HIGH[:2], 1e-3, rules) for rules in (RULES, ("snapped", "gauss")))
    assert len(few) < len(many)


@pytest.mark.parametrize("rule", RULES)
def test_one_energy_is_beer_lambert_by_every_rule(rule):
    integrand = Integrand(Source.monochromatic(60, 1e4), scintillator(), (WATER, BONE), 20.0)
    found = cheapest(integrand, np.zeros(2), np.array([400.0, 50.0]), 1e-9, (rule,))
    assert len(found) == 1
    lengths = np.array([[100.0, 20.0]])
    expected = lengths @ integrand.at(np.array([60.0]))
    np.testing.assert_allclose(found.transmission.log_projection(lengths), expected, rtol=1e-12)


@pytest.mark.parametrize("rule", ["snapped", "gauss", "compressed"])
def test_k_edge_inside_a_channel(tube_120, rule):
    """The edge of iodine in a channel of 20..34 keV: up to 0.3 in the log projection where bins ignore it."""
    integrand = Integrand(tube_120, Detector.photon_counting([20, 34], 120), (WATER, IODINE), 20.0)
    assert 33.1694 in np.round(integrand.breaks, 4)
    found = cheapest(integrand, np.zeros(2), HIGH[:2], 1e-3, (rule,))
    rays = np.random.default_rng(1).random((20, 2)) * HIGH[:2]
    np.testing.assert_allclose(found.transmission.log_projection(rays)[:, 0], truth_of(integrand, rays), atol=1.1e-3)
    assert log_error(midpoint(integrand, 64, 140.0), fine(integrand), np.zeros(2), HIGH[:2]) > 0.1


@pytest.mark.parametrize("element", ["I", "Gd", "W"])
def test_a_threshold_on_an_edge_and_a_node_on_it_are_harmless(tube_120, element):
    """A threshold on the very edge, and a midpoint node that hits it: the energy counts above."""
    edge = Material(element, composition=element).k_edges(10, 120)[0]
    integrand = Integrand(tube_120, Detector.photon_counting([20, edge], 120), (WATER,), 20.0)
    model = gauss(integrand, 12)
    assert log_error(model, fine(integrand), np.zeros(1), np.array([400.0])) < 1e-4
    low = edge - 0.5 * (120 - edge) / 10
    on_edge = Energies.midpoint(low, low + (120 - edge) / 10 * 9, 9).nodes
    assert np.abs(on_edge - edge).min() < 1e-9
    assert np.isfinite(integrand.at(on_edge)).all()


def test_a_filter_with_an_edge_joins_the_breaks():
    source = Source.tube(120, 1e5, 12, [Filter(Material("Sn", composition="Sn"), 0.3)])
    integrand = Integrand(source, scintillator(), (WATER,), 20.0)
    assert 29.2001 in np.round(integrand.breaks, 4)
    assert len(cheapest(integrand, np.zeros(1), np.array([400.0]), 1e-4, ("gauss",))) < 60


def test_a_tube_below_the_lines_of_its_anode():
    source = Source.tube(60, 1e5, 12, [Filter(Material("Al", composition="Al"), 2.5)])
    integrand = Integrand(source, Detector.photon_counting([20, 40], 60), (WATER,), 20.0)
    assert cheapest(integrand, np.zeros(1), np.array([300.0]), 1e-4).error <= 1e-4


def test_bins_below_a_kilovolt_and_finer_than_the_table(four):
    energies, photons = four.source.sampled(four.source.grid(20.0, 20000))
    assert np.median(energies.widths) == pytest.approx(0.005, rel=1e-3)  # the table has 0.5 keV
    edges = energies.edges
    assert photons.sum() == pytest.approx(four.source.photons_in(edges[[0, -1]])[0][0], rel=1e-12)


@pytest.mark.parametrize("count", [3, 17, 64, 500])
def test_rebinning_conserves_photons_and_energy(four, count):
    low, high = 20.0, four.source.maximum
    whole, mean = four.source.photons_in(np.array([low, high]))
    energies, photons = four.source.sampled(four.source.grid(low, count, four.breaks))
    assert photons.sum() == pytest.approx(whole[0], rel=1e-12)
    assert (photons * energies.nodes).sum() == pytest.approx(whole[0] * mean[0], rel=1e-12)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"rules": ("simpson",)}, "unknown energy rule 'simpson'"),
        ({"rules": ()}, "unknown energy rule 'none'"),
        ({"tolerance": 0.0}, "must be positive"),
        ({"box_high": [1.0, 2.0]}, "4 entries each"),
        ({"box_high": [1.0, 2.0, np.nan, 1.0]}, "must ascend"),
        ({"rules": ("midpoint",), "tolerance": 1e-9}, "at best"),
    ],
)
@pytest.mark.wrong_types
def test_impossible_requests_are_refused(four, arguments, words):
    wanted = {"box_low": np.zeros(4), "box_high": HIGH, "tolerance": 1e-3} | arguments
    with pytest.raises(InputError, match=words):
        cheapest(four, **wanted)


def test_a_detector_above_the_source_is_refused(tube_120):
    with pytest.raises(InputError, match="no photons are counted from 130 to 120 keV"):
        Integrand(tube_120, scintillator(), (WATER,), 130.0)
