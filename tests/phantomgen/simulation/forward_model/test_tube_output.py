"""Tube current that follows the attenuation: powers of the attenuation of an ellipsoid's axis, limits, and noise."""

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

import phantomgen
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from spectra.errors import InputError, SceneError

VIEWS = 14
TEXT = """\
version: 1
name: ellipse
source: {type: tube, kvp: 100, photons: 10000, modulation: MODULATION}
detector: {type: photon_counting, thresholds: [20, 60]}
geometry: {type: parallel, distance: 300, views: 12, test_views: 2}
panel: {rows: 3, columns: 33, pitch: 3}
volume: {voxels: 8, size: 90}
basis: [{type: compton}]
materials:
  soft: {coefficients: {compton: 0.02}}
objects:
  - {type: ellipsoid, material: soft, radii: [40, 20, 300]}
noise: false
"""


def scan_of(modulation: str):
    return load_scene(SceneFile("ellipse.yaml", TEXT.replace("MODULATION", modulation)))


def made(modulation: str, path: Path):
    """Exposure of each view, and counts."""
    with closing(phantomgen.make(scan_of(modulation), out=path, overwrite=True)) as dataset:
        return dataset.exposure[:, 0], dataset.load()


@pytest.fixture(scope="module")
def constant(tmp_path_factory):
    exposure, counts = made("{strength: 0}", tmp_path_factory.mktemp("constant") / "scan.h5")
    assert np.array_equal(exposure, np.ones(VIEWS))
    return counts


def axis_attenuation(counts):
    """Logarithm of the attenuation of all channels on the axis, which is the darkest column."""
    signal = counts.sum(axis=1)[:, 1]
    assert (signal[:, 16] <= 1.0001 * signal.min(axis=1)).all()
    return np.log(counts.sum(axis=1).max() / signal[:, 16])


@pytest.mark.parametrize("strength", [0.3, 0.5, 1.0])
def test_the_current_follows_a_power_of_the_attenuation(strength, constant, tmp_path):
    exposure, counts = made(f"{{strength: {strength}}}", tmp_path / "scan.h5")
    expected = np.exp(strength * axis_attenuation(constant))
    assert exposure == pytest.approx(expected / expected.mean(), rel=0.01)
    assert exposure.max() / exposure.min() > 1.1
    np.testing.assert_allclose(counts, constant * exposure[:, None, None, None], rtol=1e-5)


@pytest.mark.slow
def test_the_root_of_the_attenuation_leaves_the_least_noise_for_the_same_dose(constant, tmp_path):
    """Variance on the axis of a filtered back-projection: the mean over views of one over counts (Gies et al. 1999)."""
    variances = {}
    for strength in (0.0, 0.3, 0.5, 0.7, 1.0):
        _, counts = made(f"{{strength: {strength}}}", tmp_path / f"{strength}.h5")
        variances[strength] = np.mean(1 / counts.sum(axis=1)[:, 1, 16])
    assert min(variances, key=variances.get) == 0.5
    assert variances[1.0] == pytest.approx(variances[0.0], rel=0.02)


def test_limits_hold_and_the_mean_stays_one(tmp_path):
    exposure, _ = made("{strength: 1, least: 0.9, most: 1.2}", tmp_path / "scan.h5")
    assert exposure.mean() == pytest.approx(1.0)
    assert exposure.max() / exposure.min() <= 1.2 / 0.9 + 1e-9


def test_stated_factors_are_taken_as_they_are(constant, tmp_path):
    factors = np.linspace(0.5, 2, VIEWS).round(3)
    exposure, counts = made(f"{{factors: {factors.tolist()}}}", tmp_path / "scan.h5")
    assert np.array_equal(exposure, factors)
    np.testing.assert_allclose(counts, constant * exposure[:, None, None, None], rtol=1e-5)


def test_fluctuation_comes_on_top_and_may_be_unknown(tmp_path):
    found = {}
    for recorded in ("true", "false"):
        scan = load_scene(
            SceneFile("ellipse.yaml", TEXT.replace("MODULATION", "{strength: 0.5}")),
            [f"effects.tube_output={{sigma: 0.05, recorded: {recorded}}}"],
        )
        with closing(phantomgen.make(scan, out=tmp_path / f"{recorded}.h5")) as dataset:
            found[recorded] = dataset.exposure[:, 0], dataset.load()
    alone, _ = made("{strength: 0.5}", tmp_path / "alone.h5")
    assert np.array_equal(found["true"][1], found["false"][1])
    assert found["false"][0] == pytest.approx(alone)
    assert np.std(found["true"][0] / alone) == pytest.approx(0.05, rel=0.6)


@pytest.mark.parametrize(
    ("modulation", "words"),
    [
        ("{}", "needs either a strength, or a factor for each view"),
        ("{strength: 0.5, factors: [1]}", "needs either a strength, or a factor for each view"),
        ("{strength: 2}", "less than or equal to 1|at most 1|1 or less"),
        ("{strength: 0.5, least: 1.5}", "must be above 0 and include its mean, 1, got 1.5 to 10"),
        ("{factors: [1, 2, 3]}", "the scan has 14 views, test views included"),
        ("{factors: [1, -2]}", "source.modulation.factors"),
    ],
)
def test_what_a_user_can_do_wrong(modulation, words, tmp_path):
    with pytest.raises((InputError, SceneError), match=words):
        phantomgen.make(scan_of(modulation), out=tmp_path / "scan.h5")
    assert not (tmp_path / "scan.h5").exists()


def test_of_several_sources_none_may_have_a_modulated_current():
    tube = "{type: tube, kvp: 100, photons: 1000, modulation: {strength: 0.5}}"
    changes = [f"source={{type: multi_source, sources: {{low: {tube}, high: {tube}}}}}"]
    with pytest.raises((InputError, SceneError), match="a modulated current needs a source of its own"):
        phantomgen.load("kedge-small", changes)
