"""Noise of electronics in what a reconstructor gets: signals whose variance is their mean, negative ones included."""

import numpy as np
import pytest
from support.detector_scenes import counting, integrating

from phantomgen.dataset.reader import open_dataset
from phantomgen.simulation.run import simulate
from recon.data.material_decomposition import decompose_views
from recon.data.measurements import read_measurements

# Behind 16 mm of iron next to nothing is left: there electronics are all the noise, and half of the signals negative.
OBJECT = "objects=[{type: cylinder, material: iron, radius: 8, length: 200}]"
SETTINGS = ["materials={iron: {composition: Fe}}", OBJECT, "basis=[{type: material, material: iron}]", "darks=40"]
NOISE = "effects.electronics={sigma: 400, offset: 3000}"
SMALL = ["geometry.views=3", "source.photons=600", "flats=40", "panel.rows=30"]


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    path = tmp_path_factory.mktemp("electronics") / "scan.h5"
    simulate(integrating(*SETTINGS, *SMALL, NOISE), path)
    with open_dataset(path) as dataset:
        assert dataset.load().min() < 2500
        variance = dataset.dark_variance[0]
        assert abs(variance / 400**2 - 1) < 5 * np.sqrt(2 / (39 * 30 * 48))
        return read_measurements(dataset, np.arange(3)), float(variance / dataset.spectra.quantum[0] ** 2)


def test_the_variance_of_signals_is_their_mean_in_air_and_behind_iron(measured):
    scan, shift = measured
    dark, air = scan.counts[:, 0, :, 22:26], scan.counts[:, 0, :, :8]
    assert dark.mean() == pytest.approx(shift, abs=5 * np.sqrt(shift / dark.size) + 0.02 * shift)
    for part in (dark, air):
        # A mean dark of 40 frames and flats of as many add a fortieth each.
        assert part.var() / part.mean() == pytest.approx(1 + 1 / 40, abs=5 * np.sqrt(2 / part.size))
    assert scan.transmission.open_beam[0] == pytest.approx(air.mean(), rel=0.01)


def test_scans_without_such_noise_stay_as_they_are(tmp_path):
    simulate(counting("geometry.views=1", "darks=3"), tmp_path / "scan.h5")
    with open_dataset(tmp_path / "scan.h5") as dataset:
        found = read_measurements(dataset, np.arange(1), bases=2)
        np.testing.assert_array_equal(found.counts, dataset.load())
        np.testing.assert_array_equal(found.transmission.weights, dataset.spectra.transmission().weights)


def test_decomposition_stays_finite_and_compression_holds(measured):
    scan, _ = measured
    few, error = scan.compressed(1e-3)
    assert error < 1e-3
    lengths = np.linspace(0, 10, 40)[:, None]
    np.testing.assert_allclose(
        np.log(few.transmission.expected(lengths)), np.log(scan.transmission.expected(lengths)), atol=2e-3
    )
    images = decompose_views(scan)[0]
    assert np.isfinite(images).all()
    edge = images[:, 0, :, 10:14]  # some millimetres of iron
    assert abs(images[:, 0, :, :8].mean()) < 0.05
    assert edge.max() > 0.1
