"""Pulses of photon-counting sensors against photons followed one by one, and against limits that are known."""

import numpy as np
import pytest
from support.sensor_monte_carlo import counts_with_compton, pulses_of

from spectra.detector.detector import Detector, channels_between
from spectra.detector.pulse_height import ChargeSharing, PulseHeightDetector
from spectra.detector.semiconductor import charge_fractions, escape
from spectra.energy.grid import Energies
from spectra.errors import InputError
from spectra.materials.material import Material

CDTE, GAAS = Material("CdTe", composition="CdTe"), Material("GaAs", composition="GaAs")
THRESHOLDS = (20.0, 35.0, 50.0, 65.0, 90.0)
FWHM = 2.0 * 2.3548  # of a standard deviation of 2 keV
PHOTONS = 40_000


def detector(
    resolution=FWHM, fluorescence=True, charge_sharing=None, material=CDTE, thickness=1.6, thresholds=THRESHOLDS,
    compton=False,
):  # fmt: skip
    channels = channels_between(thresholds, 140)
    return PulseHeightDetector(channels, material, thickness, resolution, fluorescence, charge_sharing, compton)


def above(counts):
    """Counts above each threshold."""
    return counts[::-1].cumsum(axis=0)[::-1]


@pytest.fixture(scope="module", params=[0.11, 0.225, 0.5])
def pixels(request):
    return detector(charge_sharing=ChargeSharing(request.param, 0.018))


# Counts above 20 keV per absorbed photon, from another Monte-Carlo of 1.6 mm of CdTe with clouds of 18 um.
PUBLISHED = {0.11: (1.20, 1.56), 0.225: (1.18, 1.34), 0.5: (1.10, 1.17)}


def test_counts_above_a_low_threshold_are_those_of_another_monte_carlo(pixels):
    counts = pixels.pulses(np.array([60.0, 100.0])).sum(axis=0)
    np.testing.assert_allclose(counts, PUBLISHED[pixels.charge_sharing.pitch], atol=0.012)


@pytest.mark.parametrize("energy", [30.0, 60.0, 100.0])
def test_counts_are_those_of_photons_followed_one_by_one(pixels, energy):
    heights = pulses_of(energy, CDTE, 1.6, pixels.charge_sharing.pitch, 0.018, 2.0, PHOTONS, seed=1)
    per_photon = np.stack([(heights >= t).sum(axis=(1, 2)) for t in THRESHOLDS])
    scatter = per_photon.std(axis=1) / np.sqrt(PHOTONS)
    model = above(pixels.pulses(np.array([energy])))[:, 0]
    assert (np.abs(model - per_photon.mean(axis=1)) < 4 * scatter + 0.006).all()


def test_counts_of_gallium_arsenide_are_those_of_photons_followed_one_by_one():
    thin = detector(
        3.0, charge_sharing=ChargeSharing(0.1, 0.01), material=GAAS, thickness=0.5, thresholds=(8.0, 20.0, 35.0)
    )
    heights = pulses_of(40.0, GAAS, 0.5, 0.1, 0.01, 3.0 / 2.3548, PHOTONS, seed=2)
    model = above(thin.pulses(np.array([40.0])))[:, 0]
    found = [(heights >= t).sum() / PHOTONS for t in (8.0, 20.0, 35.0)]
    np.testing.assert_allclose(model, found, atol=0.02)


def test_a_sharp_sensor_without_effects_is_the_ideal_one():
    energies = Energies.snapped(20, 140, 100, THRESHOLDS)
    ideal = Detector.photon_counting(THRESHOLDS, 140, CDTE, 1.6)
    np.testing.assert_allclose(detector(0.0, False).response(energies), ideal.response(energies), atol=1e-12)


def test_resolution_alone_smears_a_photopeak():
    counts = detector(fluorescence=False).pulses(np.array([50.0, 65.0]))
    np.testing.assert_allclose(counts.sum(axis=0), 1.0)
    assert counts[2, 0] == pytest.approx(0.5)
    # A photon below the lowest threshold may count, and the grid of energies begins low enough to see that.
    assert 15 - 20 / 2 < detector().lowest - 5 < 20 - 5
    assert detector().pulses(np.array([19.0, detector().lowest])).sum(axis=0) == pytest.approx([0.31, 0], abs=0.01)


def test_large_pixels_lose_the_fluorescence_that_leaves_the_sensor_only():
    wide = detector(0.0, True, thresholds=(20.0, 45.0)).pulses(np.array([60.0]))[:, 0]
    assert wide.sum() == pytest.approx(1.0)
    heights = pulses_of(60.0, CDTE, 1.6, 1e3, 0.0, 0.0, PHOTONS, seed=3)
    assert wide[1] == pytest.approx((heights.max(axis=(1, 2)) >= 45).mean(), abs=4e-3)
    assert wide[1] < 0.97


@pytest.mark.parametrize("line", [23.1, 27.4])
def test_fluorescence_escapes_as_photons_followed_one_by_one_do(line):
    rng = np.random.default_rng(0)
    mu, mu_line = (CDTE.attenuation(np.array([e]))[0] for e in (35.0, line))
    depth = rng.exponential(1 / mu, PHOTONS * 5)
    depth = depth[depth < 0.2]
    end = depth + rng.exponential(1 / mu_line, len(depth)) * rng.uniform(-1, 1, len(depth))
    out = ((end < 0) | (end > 0.2)).mean()
    assert escape(np.array([mu]), mu_line, 0.2)[0] == pytest.approx(out, abs=5e-3)


@pytest.mark.parametrize(("pitch", "cloud"), [(0.25, 0.018), (0.11, 0.018), (0.05, 0.02), (0.5, 0.0)])
def test_shared_charge_is_not_lost(pitch, cloud):
    fractions, pixels = charge_fractions(pitch, cloud)
    assert (fractions * pixels).sum() == pytest.approx(1.0, abs=1e-3)


def test_half_of_the_charge_on_an_edge_goes_to_each_side():
    # More than half: the pixel's area less corners, whose charge nobody has half of.
    fractions, pixels = charge_fractions(1.0, 0.001)
    assert pixels[fractions > 0.5].sum() == pytest.approx(1.0, abs=1e-3)
    assert pixels[fractions > 0.99].sum() == pytest.approx((1 - 2 * 2.326 * 0.001) ** 2, abs=1e-3)


def test_a_photon_may_count_more_than_once():
    energies = Energies.snapped(60, 140, 40, THRESHOLDS)
    response = detector(charge_sharing=ChargeSharing(0.11, 0.018)).response(energies)
    assert response.sum(axis=0).max() > 1.2
    assert response.min() >= 0


SILICON = Material("Si", composition="Si")
LOW = (5.0, 12.0, 25.0, 45.0, 70.0)


@pytest.mark.parametrize("thickness", [0.5, 30.0])
@pytest.mark.parametrize("energy", [40.0, 80.0, 120.0])
@pytest.mark.parametrize("sharing", [None, ChargeSharing(0.1, 0.012)])
def test_photons_that_scatter_count_as_those_followed_one_by_one(energy, thickness, sharing):
    photons = 100_000 if thickness > 1 else 400_000
    scattering = PulseHeightDetector(channels_between(LOW, 140), SILICON, thickness, 2.0, False, sharing, compton=True)
    energies = np.array([energy])
    found = above(scattering.absorption(energies) * scattering.pulses(energies))[:, 0]
    cloud = 0.0 if sharing is None else sharing.cloud
    followed = counts_with_compton(energy, SILICON, thickness, 0.1, cloud, 2.0 / 2.3548, LOW, photons, seed=3)
    # Two pixels seldom see the same photon, but one may see it twice: less than 1 % of what is followed.
    assert (np.abs(found - followed) < 4 * np.sqrt(2 * followed / photons) + 0.01 * followed + 1e-4).all()


@pytest.mark.parametrize(
    ("thickness", "energy", "thresholds", "modelled", "followed"),
    [
        (0.5, 60.0, (5, 25), (0.0273, 0.0157), (0.0274, 0.0159)),
        (0.5, 100.0, (5, 45), (0.0175, 0.0031), (0.0176, 0.0031)),
        (30.0, 60.0, (5, 25), (1.165, 0.720), (1.158, 0.722)),
        (30.0, 100.0, (5, 45), (1.251, 0.324), (1.236, 0.326)),
    ],
)
def test_counts_of_silicon_are_those_of_the_documentation(thickness, energy, thresholds, modelled, followed):
    photons, energies = 150_000 if thickness > 1 else 400_000, np.array([energy])
    silicon = PulseHeightDetector(
        channels_between(thresholds, 140), SILICON, thickness, 2.0, False, ChargeSharing(0.5, 0.012), compton=True
    )
    found = above(silicon.absorption(energies) * silicon.pulses(energies))[:, 0]
    np.testing.assert_allclose(found, modelled, rtol=0.01)
    drawn = counts_with_compton(energy, SILICON, thickness, 0.5, 0.012, 2.0 / 2.3548, thresholds, photons, seed=1)
    np.testing.assert_allclose(drawn, followed, atol=3 * np.sqrt(2 * drawn.max() / photons))


def test_without_scattering_the_sensor_absorbs_what_it_stops():
    one = PulseHeightDetector(channels_between(LOW, 140), SILICON, 1.0, 2.0, False, None)
    other = PulseHeightDetector(channels_between(LOW, 140), SILICON, 1.0, 2.0, False, None, compton=True)
    energies = np.array([20.0, 100.0])
    assert one.pulses(energies).sum(axis=0) == pytest.approx(1, abs=1e-6)
    assert (other.absorption(energies) < one.absorption(energies)).all()  # Rayleigh scattering leaves no energy
    assert other.pulses(energies)[:, 0].sum() == pytest.approx(1, abs=0.2)
    assert other.model_warnings == ()


def test_silicon_is_called_poor_and_cadmium_telluride_is_not():
    silicon = detector(2.0, material=Material("Si", composition="Si"), thickness=60.0)
    assert "leaves out Compton scattering in the sensor, 8" in silicon.model_warnings[0]
    assert detector().model_warnings == ()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"resolution": -1.0}, "the resolution must be finite and not negative, got -1 keV"),
        ({"resolution": 20.0}, "a threshold of 20 keV counts electronic noise at a resolution of 20 keV"),
        (
            {"resolution": 0.0, "charge_sharing": ChargeSharing(0.2, 0.01)},
            "shared charge needs a resolution of at least 1 keV",
        ),
        ({"resolution": 0.5, "compton": True}, "Compton scattering needs a resolution of at least 1 keV, got 0.5 keV"),
        ({"thickness": 0.0}, "sensor thickness"),
    ],
)
def test_impossible_sensors_are_refused(options, words):
    with pytest.raises(InputError, match=words):
        detector(**options)


@pytest.mark.parametrize(("pitch", "cloud"), [(0.0, 0.01), (0.1, 0.1), (0.1, -0.01), (np.nan, 0.01)])
def test_impossible_pixels_are_refused(pitch, cloud):
    with pytest.raises(InputError):
        ChargeSharing(pitch, cloud)
