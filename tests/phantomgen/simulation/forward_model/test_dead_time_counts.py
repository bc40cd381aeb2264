"""Counts of detectors with dead time against arrivals that are followed one by one, and the way through a file."""

import numpy as np
import pytest

from phantomgen.dataset.describe import describe, describe_text
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.validate import validate
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.forward_model.photon_noise import dead_time_counts
from phantomgen.simulation.run import simulate
from recon.data.measurements import read_measurements
from spectra.detector.dead_time import DeadTime
from spectra.errors import InputError, SceneError

SCENE = """\
version: 1
name: toy
source: {type: tube, kvp: 80, photons: 4.0e4, filters: [{composition: Al, thickness: 2.5}]}
detector:
  {type: photon_counting, thresholds: [20, 50], dead_time: {tau_ns: 20, exposure_ms: 2, model: nonparalyzable}}
geometry: {type: circular, sod: 100, sdd: 200, views: 2}
panel: {rows: 20, columns: 20, pitch: 0.01}
volume: {voxels: 4, size: 20}
materials:
  water: {composition: H2O, density: 1.0}
objects:
  - {type: sphere, material: water, radius: 5}
flats: 20
"""
MODELS = ("nonparalyzable", "paralyzable")
SHARES = np.array([0.5, 0.3, 0.2])


def toy(*overrides):
    return load_scene(SceneFile("toy.yaml", SCENE, overrides))


def followed(load, model, pixels, rng):
    """Recorded counts per channel of pixels in 1000 dead times, arrival by arrival; (channel, pixel)."""
    exposure, counts = 1000.0, np.zeros((3, pixels), dtype=np.int64)
    for pixel in range(pixels):
        arrivals = np.cumsum(rng.exponential(1 / load, int(load * exposure + 10 * np.sqrt(load * exposure) + 20)))
        arrivals = arrivals[arrivals < exposure]
        if model == "paralyzable":
            recorded = np.diff(arrivals, prepend=-2.0) > 1.0
        else:
            recorded, free = np.zeros(len(arrivals), dtype=bool), 0.0
            for i, arrival in enumerate(arrivals.tolist()):
                if arrival >= free:
                    recorded[i], free = True, arrival + 1.0
        counts[:, pixel] = np.bincount(rng.choice(3, len(arrivals), p=SHARES)[recorded], minlength=3)
    return counts


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("load", [0.1, 0.5])
def test_counts_have_the_moments_of_arrivals_followed_one_by_one(model, load):
    truth = followed(load, model, 1500, np.random.default_rng(3)).astype(float)
    dead_time = DeadTime(1e3, 1.0, model)  # 1 us in 1 ms
    means = np.broadcast_to((load * 1000 * SHARES)[:, None, None], (3, 200, 200))
    drawn = np.stack(dead_time_counts(means, means.sum(axis=0), dead_time, 1, 0)).reshape(3, -1).astype(float)
    for counts, other in ((drawn.sum(axis=0), truth.sum(axis=0)), *zip(drawn, truth, strict=True)):
        assert counts.mean() == pytest.approx(other.mean(), abs=5 * other.std() / np.sqrt(other.size) + 0.5)
        assert counts.var() == pytest.approx(other.var(), rel=5 * np.sqrt(2 / other.size))
    # Channels of one pixel compete for its time.
    expected, found = np.cov(truth)[0, 1], np.cov(drawn)[0, 1]
    assert found < 0
    assert found == pytest.approx(expected, abs=5 * truth[0].std() * truth[1].std() / np.sqrt(truth.shape[1]))
    fano = dead_time.fano(np.array([load * 1000.0]))[0]
    assert drawn.sum(axis=0).var() / drawn.sum(axis=0).mean() == pytest.approx(fano, rel=0.03)


def test_without_load_counts_are_poisson():
    counts = np.stack(
        dead_time_counts(np.full((2, 300, 300), 5.0), np.full((300, 300), 10.0), DeadTime(1e-6, 1.0), 0, 0)
    ).astype(float)
    np.testing.assert_allclose(counts.mean(axis=(1, 2)), 5.0, atol=0.05)
    np.testing.assert_allclose(counts.var(axis=(1, 2)), 5.0, rtol=0.03)
    assert abs(np.corrcoef(counts.reshape(2, -1))[0, 1]) < 0.02
    assert np.max(dead_time_counts(np.zeros((2, 3, 3)), np.zeros((3, 3)), DeadTime(10, 1.0), 0, 0)) == 0


def test_images_depend_on_their_key_only():
    means, dead_time = np.full((2, 8, 8), 500.0), DeadTime(1e3, 1.0)
    first = np.stack(dead_time_counts(means, means.sum(axis=0), dead_time, 1, 5))
    np.testing.assert_array_equal(first, dead_time_counts(means, means.sum(axis=0), dead_time, 1, 5))
    assert (first != np.stack(dead_time_counts(means, means.sum(axis=0), dead_time, 1, 6))).any()


@pytest.mark.parametrize("model", MODELS)
def test_a_reconstructor_gets_events_back(tmp_path, model):
    simulate(toy(f"detector.dead_time.model={model}"), tmp_path / "dead.h5", keep_expected=True)
    assert validate(tmp_path / "dead.h5") == []
    assert f"dead time  20 ns per count, 2 ms per view, {model}" in describe_text(describe(tmp_path / "dead.h5"))
    with open_dataset(tmp_path / "dead.h5") as dataset:
        assert dataset.spectra.dead_time == DeadTime(20, 2, model)
        events, flat = dataset.spectra.weights.sum(axis=1), dataset.flat.mean(axis=(1, 2))
        measured = read_measurements(dataset, np.array([0]))
        raw, kept = dataset.load([0])[0].mean(axis=(1, 2)), dataset.file["truth/expected"][0].mean(axis=(1, 2))
    load = events.sum() * 20e-6 / 2
    assert 0.2 < load < 0.5
    lost = 1 / (1 + load) if model == "nonparalyzable" else np.exp(-load)
    np.testing.assert_allclose(flat, events * lost, rtol=1e-3)
    np.testing.assert_allclose(raw, kept, rtol=5e-3)
    # Gains are 1, as without dead time, and counts behind 10 mm of water are those that the model expects there.
    np.testing.assert_allclose(measured.gains.mean(axis=(1, 2)), 1.0, rtol=1e-3)
    simulate(toy("detector.dead_time=null", "noise=false"), tmp_path / "ideal.h5")
    with open_dataset(tmp_path / "ideal.h5") as ideal:
        assert ideal.spectra.dead_time is None
        wanted = ideal.load([0])[0].mean(axis=(1, 2))
    np.testing.assert_allclose(measured.counts[0].mean(axis=(1, 2)), wanted, rtol=5e-3)


def test_a_paralysed_detector_is_warned_of_and_refused_by_the_reconstructor(tmp_path):
    scan = toy("detector.dead_time={tau_ns: 100, exposure_ms: 1, model: paralyzable}")
    assert any("events per dead time, more than 1" in w for w in simulate(scan, tmp_path / "dead.h5").warnings)
    words = "counts of a paralyzable detector can be corrected up to 1 only"
    with open_dataset(tmp_path / "dead.h5") as dataset, pytest.raises(InputError, match=words):
        read_measurements(dataset, np.array([0]))


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("detector.dead_time.tau_ns=-1", "detector.dead_time.tau_ns - input should be greater than 0"),
        (
            "detector.dead_time.model=dead",
            "detector.dead_time.model - input should be 'nonparalyzable' or 'paralyzable'",
        ),
        ("detector.dead_time={tau_ns: 5}", "detector.dead_time.exposure_ms - is missing"),
    ],
)
def test_impossible_dead_times_are_refused(override, words):
    with pytest.raises(SceneError) as caught:
        toy(override)
    assert words in str(caught.value)
