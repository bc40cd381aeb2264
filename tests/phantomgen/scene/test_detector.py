"""Detectors of scene files: what they become, and what is refused where."""

import numpy as np
import pytest

from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.validate import validate
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.run import simulate
from spectra.detector.detector import Detector
from spectra.detector.pulse_height import ChargeSharing, PulseHeightDetector
from spectra.energy.grid import Energies
from spectra.errors import SceneError

SCENE = """\
version: 1
name: toy
source: {type: tube, kvp: 80, photons: 1.0e4, filters: [{composition: Al, thickness: 2.5}]}
detector: {type: photon_counting, thresholds: [20, 50]}
geometry: {type: circular, sod: 100, sdd: 200, views: 2}
panel: {rows: 6, columns: 8, pitch: 2}
volume: {voxels: 4, size: 20}
materials:
  water: {composition: H2O, density: 1.0}
objects:
  - {type: sphere, material: water, radius: 5}
flats: 4
"""
REAL = (
    "detector.resolution=4.7",
    "detector.fluorescence=true",
    "detector.charge_sharing={pitch: 0.25, cloud: 0.018}",
)


def toy(*overrides):
    return load_scene(SceneFile("toy.yaml", SCENE, overrides))


def test_a_detector_is_ideal_unless_the_scene_says_more():
    assert type(toy().detector) is Detector
    real = toy(*REAL).detector
    assert isinstance(real, PulseHeightDetector)
    assert (real.resolution, real.fluorescence, real.charge_sharing) == (4.7, True, ChargeSharing(0.25, 0.018, True))


def test_a_dataset_holds_the_response_with_all_effects(tmp_path):
    scan = toy(*REAL)
    summary = simulate(scan, tmp_path / "real.h5", tolerance=1e-4)
    assert validate(tmp_path / "real.h5") == []
    assert summary.error.ray_worst < 1e-4
    with open_dataset(tmp_path / "real.h5") as dataset:
        spectra, flat = dataset.spectra, dataset.flat
    # Photons below the threshold of 20 keV that noise lifts above it, and more counts than photons above it.
    assert spectra.edges[0] < 12
    assert spectra.response[:, spectra.energy > 70].sum(axis=0).min() > 1.1
    level = spectra.weights.sum(axis=1)
    np.testing.assert_allclose(flat.mean(axis=(1, 2)), level, atol=5 * np.sqrt(level.max() / flat[0].size / 4))


def test_what_a_response_leaves_out_is_said(tmp_path):
    scan = toy("detector.composition=Si", "detector.thickness=60", "detector.resolution=2")
    assert any("leaves out Compton scattering" in warning for warning in simulate(scan, tmp_path / "si.h5").warnings)


def test_photons_scatter_in_silicon(tmp_path):
    silicon = (
        "detector.composition=Si",
        "detector.thickness=30",
        "detector.resolution=2",
        "detector.thresholds=[6, 30]",
    )
    summary = simulate(toy(*silicon, "detector.compton=true"), tmp_path / "si.h5", tolerance=1e-4)
    assert not [warning for warning in summary.warnings if "Compton" in warning]
    assert summary.error.ray_worst < 1e-4
    with open_dataset(tmp_path / "si.h5") as dataset:
        counts = dataset.spectra.weights.sum(axis=1)
    plain = toy(*silicon).detector
    assert isinstance(plain, PulseHeightDetector)
    energies, photons = toy(*silicon).source.sampled(Energies.from_edges(np.linspace(5, 80, 300)))
    absorbed = plain.response(energies) @ photons
    assert counts[0] > 1.5 * absorbed[0]  # electrons of less than 30 keV, many of them with the photon besides
    assert counts[1] < absorbed[1]


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (("detector.thresholds=[20, 90]",), "channel bin1 starts at 90 keV and sees no photons: the source ends at 80"),
        (("detector.resolution=-1",), "detector.resolution - input should be greater than or equal to 0"),
        (("detector.resolution=30",), "a threshold of 20 keV counts electronic noise"),
        (("detector.charge_sharing={pitch: 0.25, cloud: 0.01}",), "shared charge needs a resolution"),
        (("detector.charge_sharing={pitch: 0.25}",), "detector.charge_sharing.cloud - is missing"),
        ((*REAL, "detector.charge_sharing.cloud=0.3"), "a charge cloud must be smaller than a pixel of 0.25 mm"),
        (
            ("detector.compton=true", "detector.resolution=0.5"),
            "Compton scattering needs a resolution of at least 1 keV",
        ),
        (
            (*REAL, "detector.compton=true", "detector.charge_sharing.covariance=true"),
            "detector.charge_sharing.covariance - is not known for a detector with Compton scattering",
        ),
        (("detector.thickness=0",), "detector.thickness - input should be greater than 0"),
    ],
)
def test_impossible_detectors_are_refused(overrides, words):
    with pytest.raises(SceneError) as caught:
        toy(*overrides)
    message = str(caught.value)
    assert "\n" not in message
    assert words in message
