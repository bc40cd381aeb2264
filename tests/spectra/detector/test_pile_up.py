"""Pulses that pile up in the pixels of a detector: photons followed one by one, and what is corrected."""

import numpy as np
import pytest
from support.arrivals import counts_of_arrivals

from spectra.detector.dead_time import DeadTime
from spectra.detector.detector import Detector
from spectra.detector.pile_up import PileUp, PulseResponse, PulseSpectra, edges_of, pulse_detector
from spectra.detector.pulse_height import PulseHeightDetector
from spectra.energy.grid import Energies
from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.source.source import Filter, Source

MODELS = ("nonparalyzable", "paralyzable")
IDEAL = Detector.photon_counting([25, 50, 70], 120)
BLURRED = PulseHeightDetector(IDEAL.channels, IDEAL.material, IDEAL.thickness, resolution=6.0)
TUBE = Source.tube(120, 1e5, 12, [Filter(Material("Al", composition="Al"), 3.0)])
ENERGIES, PHOTONS = TUBE.sampled(Energies.from_edges(np.linspace(15, 120, 211)))
WATER = Material("water", 1.0, "H2O")
BEHIND = {
    "air": 0.0 * ENERGIES.nodes,
    "water": 150 * WATER.attenuation(ENERGIES.nodes),
    "bone": 20 * Material("bone", 1.9, "Bone, Cortical (ICRP)").attenuation(ENERGIES.nodes),
    "iodine": 40 * Material("iodine", 1.02, {"H": 0.11, "O": 0.87, "I": 0.02}).attenuation(ENERGIES.nodes),
    "steel": 3 * Material("Fe", composition="Fe").attenuation(ENERGIES.nodes),
}


def loaded(photons, detector, load, model="nonparalyzable"):
    """Pile-up at so many pulses per dead time."""
    events = (detector.response(ENERGIES) * photons).sum()
    dead_time = DeadTime(load / events * 1e6, 1.0, model)
    return PileUp(dead_time, detector.thresholds, edges_of(pulse_detector(detector)))


def spectra_of(detector):
    pulses = PulseResponse.of(pulse_detector(detector), ENERGIES)
    return PulseSpectra.behind_water(PHOTONS * pulses.response, WATER.attenuation(ENERGIES.nodes))


@pytest.mark.parametrize("detector", [IDEAL, BLURRED])
def test_groups_add_up_to_the_channels(detector):
    finer, own = pulse_detector(detector), loaded(PHOTONS, detector, 0.1)
    assert max(c.upper - c.lower for c in finer.channels[:-1]) <= 2.5
    assert set(detector.thresholds) <= set(finer.thresholds)
    summed = np.add.reduceat(finer.response(ENERGIES), own.starts[:-1])
    np.testing.assert_allclose(summed, detector.response(ENERGIES), atol=1e-8)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("matter", ["air", "bone"])
def test_counts_are_those_of_photons_followed_one_by_one(model, matter):
    count, load, rng = 1_000_000, 0.4, np.random.default_rng(5)
    photons = PHOTONS * np.exp(-BEHIND[matter])
    detected = (photons * IDEAL.absorption(ENERGIES.nodes))[ENERGIES.nodes >= 25]
    edges = ENERGIES.edges[ENERGIES.edges >= 25]
    one = rng.choice(len(detected), count, p=detected / detected.sum())
    heights = rng.uniform(edges[one], edges[one + 1])
    followed, error = counts_of_arrivals(heights, load, IDEAL.thresholds, model == "paralyzable", rng)
    pulses = pulse_detector(IDEAL).response(ENERGIES) @ photons
    found = loaded(photons, IDEAL, load, model).recorded(pulses[:, None, None])[:, 0, 0] / pulses.sum()
    assert (error < 0.025 * followed).all()
    assert (np.abs(found - followed) < 4 * error + 1e-3 * followed).all()


@pytest.mark.parametrize("model", MODELS)
def test_the_lowest_threshold_counts_as_if_heights_did_not_matter(model):
    pulses = (pulse_detector(IDEAL).response(ENERGIES) @ PHOTONS)[:, None, None] * np.linspace(0, 1, 7)
    pile_up = loaded(PHOTONS, IDEAL, 0.9, model)
    plain = pile_up.dead_time.recorded(pulses)
    np.testing.assert_allclose(pile_up.recorded(pulses).sum(axis=0), plain.sum(axis=0), rtol=1e-12)


@pytest.mark.parametrize("detector", [IDEAL, BLURRED])
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("matter", BEHIND)
def test_events_are_found_behind_any_matter(matter, model, detector):
    photons = PHOTONS * np.exp(-BEHIND[matter])
    events, pulses = (d.response(ENERGIES) @ photons for d in (detector, pulse_detector(detector)))
    pile_up = loaded(PHOTONS, detector, 0.4, model)  # in air
    recorded = pile_up.recorded(pulses[:, None, None])
    found = pile_up.corrected(recorded, spectra_of(detector))[:, 0, 0]
    without = pile_up.dead_time.corrected(recorded)[:, 0, 0]
    np.testing.assert_allclose(found, events, rtol=0.004)
    if matter == "air" and model == "nonparalyzable" and detector is IDEAL:  # what is said in the documentation
        np.testing.assert_allclose(without / events - 1, [-0.33, -0.30, 1.30], atol=0.005)


@pytest.mark.parametrize("model", MODELS)
def test_events_are_found_up_to_the_highest_load(model):
    events, pulses = (d.response(ENERGIES) @ PHOTONS for d in (IDEAL, pulse_detector(IDEAL)))
    highest = loaded(PHOTONS, IDEAL, 0.1, model).highest_load
    pile_up = loaded(PHOTONS, IDEAL, highest, model)
    found = pile_up.corrected(pile_up.recorded(pulses[:, None, None]), spectra_of(IDEAL))[:, 0, 0]
    np.testing.assert_allclose(found, events, rtol=0.01)


@pytest.mark.parametrize("edges", [[25.0, 70.0, 50.0, 120.0], [26.0, 50.0, 70.0, 120.0], [25.0, 51.0, 70.0, 120.0]])
def test_groups_that_do_not_hold_the_thresholds_are_refused(edges):
    with pytest.raises(InputError, match="limits of pulse heights must ascend, begin at the lowest threshold and hold"):
        PileUp(DeadTime(10, 1), IDEAL.thresholds, np.array(edges))


def test_pulses_within_channels_are_those_behind_water():
    photons = PHOTONS * np.exp(-BEHIND["water"])
    pulses = pulse_detector(IDEAL).response(ENERGIES) @ photons
    pile_up, table = loaded(PHOTONS, IDEAL, 0.4), spectra_of(IDEAL)
    events = (IDEAL.response(ENERGIES) @ photons)[:, None, None]
    np.testing.assert_allclose(pile_up.pulses(events, table)[:, 0, 0], pulses, atol=2e-3 * pulses.max())
    np.testing.assert_allclose(np.add.reduceat(table.shapes(pile_up.starts), pile_up.starts[:-1], axis=1), 1)


@pytest.mark.parametrize("model", MODELS)
def test_one_counter_only_loses_counts(model):
    detector = Detector.photon_counting([25], 120)
    events = np.array([[[1e4, 2e4, 0.0]]])
    pile_up = loaded(PHOTONS, detector, 0.4, model)
    np.testing.assert_allclose(pile_up.recorded(events), pile_up.dead_time.recorded(events), rtol=1e-12)
    recorded = pile_up.recorded(events)
    np.testing.assert_allclose(pile_up.corrected(recorded, spectra_of(detector)), events, rtol=1e-6)
