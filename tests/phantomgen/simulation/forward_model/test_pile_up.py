"""Pulses that pile up, from the scene through the file to the events that a reconstructor sees."""

import h5py
import numpy as np
import pytest

from phantomgen.dataset.describe import describe, describe_text
from phantomgen.dataset.file import seal_file
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.validate import validate
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.run import simulate
from phantomgen.torch.forward_model import ForwardModel
from recon.calibration.spectrum_file import check_plain
from spectra.errors import DatasetError, InputError, SceneError

SCENE = """\
version: 1
name: toy
source: {type: tube, kvp: 100, photons: 4.0e4, filters: [{composition: Al, thickness: 2.5}]}
detector:
  {type: photon_counting, thresholds: [20, 50, 65], dead_time: {tau_ns: 20, exposure_ms: 2}, pile_up: true}
geometry: {type: circular, sod: 100, sdd: 200, views: 2}
panel: {rows: 16, columns: 16, pitch: 0.5}
volume: {voxels: 4, size: 20}
materials:
  water: {composition: H2O, density: 1.0}
objects:
  - {type: sphere, material: water, radius: 3}
flats: 20
"""
QUIET, PLAIN = "noise=false", "detector.pile_up=false"
IDEAL = "detector={type: photon_counting, thresholds: [20, 50, 65]}"
KINDS = pytest.mark.parametrize("kind", ["nonparalyzable", "paralyzable"])


def made(path, *overrides):
    simulate(load_scene(SceneFile("toy.yaml", SCENE, overrides)), path)
    return open_dataset(path)


def events(dataset):
    return dataset.spectra.events(dataset.load([0])[0] - dataset.dark)


@KINDS
@pytest.mark.parametrize("more", ["", "detector.resolution=5", "effects.scatter={type: compton}"])
def test_events_are_those_of_a_detector_without_dead_time(kind, more, tmp_path):
    kinds = (QUIET, f"detector.dead_time.model={kind}", *([more] if more else []))
    ideal = ("detector.dead_time=null", PLAIN, QUIET, *([more] if more else []))
    with made(tmp_path / "piled.h5", *kinds) as piled, made(tmp_path / "ideal.h5", *ideal) as other:
        assert not validate(tmp_path / "piled.h5")
        load = piled.spectra.dead_time.per_count * other.load([0])[0].sum(axis=0).max()
        assert load > 0.2
        wrong = piled.spectra.dead_time.corrected(piled.load([0])[0])
        assert np.abs(wrong / events(other) - 1).max() > 0.2
        np.testing.assert_allclose(events(piled), events(other), rtol=3e-3)
        np.testing.assert_allclose(piled.spectra.recorded(events(piled)), piled.load([0])[0], rtol=1e-3)
        flats = (d.spectra.events(d.flat) for d in (piled, other))
        np.testing.assert_allclose(*flats, rtol=3e-3)


@KINDS
def test_drawn_counts_have_the_mean_and_less_than_its_variance(kind, tmp_path):
    model = f"detector.dead_time.model={kind}"
    with made(tmp_path / "drawn.h5", model, "flats=60") as drawn, made(tmp_path / "mean.h5", model, QUIET) as mean:
        frames, expected = drawn.file["/entry/instrument/flat/data"][...].astype(float), mean.flat
        spread = np.sqrt(expected / len(frames))
        assert np.abs((frames.mean(axis=0) - expected) / spread).max() < 4.5
        total = frames.sum(axis=1)
        fano = total.var(axis=0, ddof=1).mean() / total.mean()
        known = drawn.spectra.dead_time.fano(np.array([drawn.spectra.weights.sum()]))[0]
        assert known < 0.7
        assert fano == pytest.approx(known, rel=0.05)
        corrected = np.stack([drawn.spectra.events(frame) for frame in frames])
        air = np.broadcast_to(drawn.spectra.weights.sum(axis=1)[:, None, None], expected.shape)
        spread = corrected.var(axis=0, ddof=1).mean(axis=(1, 2)) / corrected.mean(axis=(0, 2, 3))
        np.testing.assert_allclose(spread, drawn.spectra.spread(air)[:, 0, 0], rtol=0.05)


def test_counters_above_thresholds_are_sums_of_the_same_counts(tmp_path):
    with made(tmp_path / "bins.h5") as bins, made(tmp_path / "above.h5", "detector.counters=cumulative") as above:
        np.testing.assert_array_equal(bins.load([0]), above.load([0]))
        np.testing.assert_array_equal(events(bins), events(above))
        assert bins.spectra.pulses is not None
        np.testing.assert_array_equal(bins.spectra.pulses.response, above.spectra.pulses.response)


def test_gains_are_of_channels_and_files_tell_of_pile_up(tmp_path):
    with (
        made(tmp_path / "gain.h5", "effects.gain={sigma: 0.02, in_flats: false}", QUIET) as gain,
        made(tmp_path / "a.h5", QUIET) as one,
    ):
        ratio = events(gain) / events(one)
        assert 0.01 < ratio.std() < 0.03
    assert "heights of pulses add" in describe_text(describe(tmp_path / "gain.h5"))
    with made(tmp_path / "plain.h5", PLAIN) as plain:
        assert plain.spectra.pulses is None
    assert "heights" not in describe_text(describe(tmp_path / "plain.h5"))


def test_what_cannot_be_is_refused(tmp_path):
    with pytest.raises(SceneError, match=r"detector\.pile_up - needs detector\.dead_time, in which pulses pile up"):
        load_scene(SceneFile("toy.yaml", SCENE, ("detector.dead_time=null",)))
    with made(tmp_path / "piled.h5") as piled:
        with pytest.raises(DatasetError, match="pulses that pile up"):
            ForwardModel.of(piled)
        with pytest.raises(
            InputError, match="its pulses pile up; the spectral model of such a scan cannot be replaced or refined"
        ):
            check_plain(piled)


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("pulse_edges", None, "lacks /entry/instrument/detector/pulse_edges"),
        ("pulse_response", None, "lacks /entry/instrument/detector/pulse_response"),
        ("dead_time", None, "heights of pulses that pile up need a dead time"),
        ("pulse_edges", 1.3, "those from 21.3 to 101.3 keV do not"),
    ],
)
def test_damaged_heights_are_refused_with_the_name_of_the_file(path, value, words, tmp_path):
    made(tmp_path / "piled.h5").close()
    with h5py.File(tmp_path / "piled.h5", "r+") as file:
        detector = file["/entry/instrument/detector"]
        if value is None:
            del detector[path]
        else:
            detector[path][...] += value
    seal_file(tmp_path / "piled.h5")
    with pytest.raises(DatasetError, match=rf"piled\.h5.*{words}"), open_dataset(tmp_path / "piled.h5") as dataset:
        assert dataset.spectra
