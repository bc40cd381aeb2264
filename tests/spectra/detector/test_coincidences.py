"""Photons that count in two neighbouring pixels, against photons followed one by one."""

import numpy as np
import pytest
from support.sensor_monte_carlo import pulses_of

from spectra.detector.coincidences import CoincidenceShares, coincidences
from spectra.detector.detector import channels_between
from spectra.detector.pulse_height import ChargeSharing, PulseHeightDetector
from spectra.energy.grid import Energies
from spectra.materials.material import Material

CDTE = Material("CdTe", composition="CdTe")
THRESHOLDS = (20.0, 35.0, 50.0, 65.0, 90.0)
PHOTONS = 60_000


def detector(pitch, cloud=0.018, top=140.0):
    channels = channels_between(THRESHOLDS, top)
    return PulseHeightDetector(channels, CDTE, 1.6, 4.7, True, ChargeSharing(pitch, cloud))


def counted(pixels, energy):
    """Whether each photon counts in each channel of each pixel around, (channel, photon, row, column)."""
    heights = pulses_of(energy, CDTE, 1.6, pixels.charge_sharing.pitch, 0.018, 4.7 / 2.3548, PHOTONS, seed=1)
    return np.stack(
        [(heights >= c.lower) & (heights < (c.upper if c.upper < 140 else np.inf)) for c in pixels.channels]
    )


def at_once(first, second):
    """Photons that count in both pixels, per photon, in any order of the channels."""
    pairs = np.einsum("anyx,bnyx->ab", first, second, dtype=np.float64) / PHOTONS
    return (pairs + pairs.T) / 2


@pytest.mark.parametrize(("pitch", "energy"), [(0.11, 60.0), (0.225, 100.0)])
def test_coincidences_are_those_of_photons_followed_one_by_one(pitch, energy):
    pixels = detector(pitch)
    hits = counted(pixels, energy)
    found = coincidences(pixels, np.array([energy]))[..., 0]
    beside = (at_once(hits[..., :-1], hits[..., 1:]) + at_once(hits[:, :, :-1], hits[:, :, 1:])) / 2
    across = (at_once(hits[..., :-1, :-1], hits[..., 1:, 1:]) + at_once(hits[..., :-1, 1:], hits[..., 1:, :-1])) / 2
    assert beside.sum() > 0.05
    for model, followed in zip(found, (beside, across), strict=True):
        noise = np.sqrt(followed / PHOTONS)  # of two pairs of pixels, or of two orders of the channels
        assert (np.abs(model - followed) < 4 * noise + 6e-4).all()
    np.testing.assert_allclose(found, found.swapaxes(1, 2))


def test_large_pixels_with_narrow_clouds_count_together_by_fluorescence_only():
    without = PulseHeightDetector(channels_between(THRESHOLDS, 140), CDTE, 1.6, 4.7, False, ChargeSharing(0.5, 0.0))
    assert coincidences(without, np.array([60.0])).sum() == 0
    with_lines = PulseHeightDetector(channels_between(THRESHOLDS, 140), CDTE, 1.6, 4.7, True, ChargeSharing(0.5, 0.0))
    # Fluorescence of 23 to 31 keV counts in the lowest channel, and leaves the photon 29 to 37 keV.
    found = coincidences(with_lines, np.array([60.0]))[0, :, :, 0]
    assert found[0].sum() > 0.01
    assert found[2:, 2:].max() < 1e-12


def test_counts_determine_the_coincidences_of_every_spectrum():
    pixels, energies = detector(0.225), Energies.snapped(18, 120, 40, THRESHOLDS)
    rng = np.random.default_rng(0)
    water = Material("water", composition="H2O", density=1.0).attenuation(energies.nodes)
    open_beam = np.where(energies.nodes < 120, energies.nodes * (120 - energies.nodes), 0.0)
    photons = open_beam * np.exp(-rng.uniform(0, 300, 20)[:, None] * water)
    found = CoincidenceShares.of(pixels, energies, photons)
    exact = np.einsum(
        "e,e,sabe->sab", photons[3], pixels.absorption(energies.nodes), coincidences(pixels, energies.nodes)
    )
    counts = pixels.response(energies) @ photons[3]
    correlation = np.sqrt(np.outer(counts, counts))
    assert found.part == 1
    assert found.error < 0.01
    assert np.abs(found.shares @ counts - exact).max() <= found.error * correlation.max()
    np.testing.assert_allclose(found.shares @ counts / correlation, exact / correlation, atol=0.01)
    # Lowest channels of neighbours are correlated by 0.05 to 0.15 in pixels of 0.225 mm.
    assert 0.05 < (found.shares @ counts)[0, 0, 0] / counts[0] < 0.15
    assert found.shares.min() >= 0


def test_pairs_do_not_exceed_the_counts_where_photons_count_in_many_pixels():
    energies = Energies.snapped(99, 101, 2, ())
    found = CoincidenceShares.of(detector(0.11), energies, np.ones((1, 2)))
    counts = detector(0.11).response(energies).sum(axis=1)
    assert found.part < 1
    assert (4 * (found.shares @ counts).sum(axis=(0, 1)) <= counts * (1 + 1e-9) + 1e-6).all()
