"""Scans with energy-integrating detectors: compound noise, files, and what a reconstructor makes of them."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from support.edited_datasets import edited_dataset

from phantomgen.dataset.describe import describe, describe_text
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.validate import validate
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.forward_model.energy_grids import STEP, fine_transmission
from phantomgen.simulation.forward_model.exposure import Exposure
from phantomgen.simulation.forward_model.photon_noise import compound_signal
from phantomgen.simulation.run import simulate
from recon.data.measurements import read_measurements
from spectra.elements.attenuation import linear_attenuation
from spectra.errors import DatasetError, InputError, SceneError
from spectra.threads import set_threads

SCENE = """\
version: 1
name: toy
source: {type: tube, kvp: 120, photons: 2000, filters: [{composition: Al, thickness: 2.5}]}
detector: {type: energy_integrating}
geometry: {type: circular, sod: 500, sdd: 800, views: 12}
panel: {rows: 40, columns: 40, pitch: 0.1}
volume: {voxels: 4, size: 220}
materials:
  water: {composition: H2O, density: 1.0}
objects:
  - {type: box, material: water, size: [200, 200, 200]}
flats: 6
"""


def toy(*overrides):
    return load_scene(SceneFile("toy.yaml", SCENE, overrides))


def fine_energies(scan):
    """Energies of the nodes of `fine_transmission`, which leaves out those without photons."""
    count = np.ceil((scan.source.maximum - scan.detector.lowest) / STEP)
    grid = scan.source.grid(
        scan.detector.lowest, int(max(count, 1 / STEP)), (*scan.detector.breaks, *scan.basis.breaks)
    )
    energies, photons = scan.source.sampled(grid)
    return energies.nodes[photons * scan.detector.response(energies)[0] > 0]


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("integrating") / "toy.h5"
    simulate(toy("geometry.views=1"), path, keep_expected=True)
    return path


def test_the_signal_is_compound_poisson_in_air_and_behind_water(path):
    with open_dataset(path) as dataset:
        spectra = dataset.spectra
        flats = dataset.file["entry/instrument/flat/data"][:, 0].astype(float)
        image, mean = dataset.load()[0, 0].astype(float), dataset.file["truth/expected"][0, 0].astype(float)
    water = np.exp(-200 * linear_attenuation("H2O", 1.0, spectra.energy))
    for signal, expected, passed in ((flats, spectra.weights.sum(), 1.0), (image, mean, water)):
        variance = (spectra.source * spectra.variance[0] * passed).sum()
        chi = (signal - expected) ** 2 / variance
        assert chi.mean() == pytest.approx(1.0, abs=5 * np.sqrt(2 / chi.size))
        assert abs((signal - expected).mean()) < 5 * np.sqrt(variance / signal.size)
    # Plain Poisson noise of as many photons would have 11 % less in air: the test would see it.
    photons = (spectra.source * spectra.response[0] / spectra.energy).sum()
    assert spectra.weights.sum() ** 2 / photons < 0.9 * (spectra.source * spectra.variance[0]).sum()


def test_drawn_signals_have_the_first_three_moments_of_a_compound_sum():
    means, quanta = np.array([120.0, 400.0, 90.0]), np.array([30.0, 60.0, 90.0])
    signal = compound_signal(np.broadcast_to(means[:, None, None], (3, 500, 500)), quanta, 1, 0, 0).astype(float)
    cumulants = [(means * quanta**power).sum() for power in range(3)]
    assert signal.mean() == pytest.approx(cumulants[0], abs=5 * np.sqrt(cumulants[1] / signal.size))
    assert signal.var() == pytest.approx(cumulants[1], rel=0.02)
    skewness = ((signal - signal.mean()) ** 3).mean() / signal.std() ** 3
    assert skewness == pytest.approx(cumulants[2] / cumulants[1] ** 1.5, abs=5 * np.sqrt(6 / signal.size))
    starved = compound_signal(np.broadcast_to(means[:, None, None] / 10, (3, 500, 500)), quanta, 1, 1, 0)
    assert (starved == 0).mean() == pytest.approx(np.exp(-(means / quanta).sum() / 10), rel=0.02)


@pytest.mark.parametrize("refine", [True, False])
@pytest.mark.parametrize(
    "overrides",
    [
        (),
        ("materials.water.composition=Fe", "materials.water.density=7.87", "objects.0.size=[5,5,5]"),
        ("source={type: monochromatic, energy: 60, photons: 2000}",),
        ("source={type: lines, lines: {30: 1, 60: 2, 100: 1}, photons: 2000}",),
        ("source.bowtie={composition: Al, angles: [0, 6], thickness: [1, 20]}", "panel.pitch=4"),
    ],
    ids=["water", "iron", "one energy", "lines", "bowtie"],
)
def test_groups_of_photons_have_the_moments_of_all_energies(overrides, refine):
    scan, rng = toy(*overrides), np.random.default_rng(5)
    lengths = rng.uniform(0, 200 if "Fe" not in str(overrides) else 5, (300, 1))
    exposure, error = Exposure.of(scan, lengths, 2e-4, refine=refine)
    fine = fine_transmission(scan)
    rays = rng.permutation(lengths)[:50]
    if scan.profile is not None:
        parts = scan.profile.lengths.reshape(len(scan.profile.names), -1).T
        rays = np.hstack([rays, parts[rng.integers(len(parts), size=50)]])
    energies, left = fine_energies(scan), fine.weights * np.exp(-rays @ fine.columns)
    groups = exposure.groups.expected(rays)
    assert error < 2e-4
    # The number of photons, and the first three cumulants of the signal.
    for power, tolerance in ((-1, 0.05), (0, 4e-4), (1, 2e-3), (2, 0.02)):
        exact, found = (left * energies**power).sum(axis=1), (groups * exposure.quanta**power).sum(axis=1)
        np.testing.assert_allclose(found, exact, rtol=tolerance, err_msg=f"power {power}")
    assert len(exposure.groups) <= 12


def test_the_mean_is_the_sum_of_energies(path):
    with open_dataset(path) as dataset:
        spectra, mean = dataset.spectra, dataset.file["truth/expected"][0, 0, 20, 20]
    weights, energy = spectra.weights[0], spectra.energy
    # 200 mm of water on the central ray; the file has the bins of a reconstructor, some 1 keV wide.
    assert mean == pytest.approx((weights * np.exp(-200 * linear_attenuation("H2O", 1.0, energy))).sum(), rel=1e-3)


def test_the_file_says_that_it_holds_energies(path):
    assert validate(path) == []
    info = describe(path)
    assert (info["units"], info["dtype"], info["nxtomo"]) == ("keV", "float32", [])
    assert "float32 in keV" in describe_text(info)
    assert "NXtomo     none" in describe_text(info)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("/entry/spectra/variance", None, "variance belongs to signals in keV"),
        ("/entry/spectra/variance", np.ones((2, 3)), "variance has shape (2, 3)"),
        ("/entry/spectra/variance", -1.0, "variance holds -1, expected numbers from 0"),
    ],
)
@pytest.mark.wrong_types
def test_a_damaged_variance_is_found(path, tmp_path, name, value, words):
    copied = Path(shutil.copy(path, tmp_path))
    with edited_dataset(copied) as file:
        shape = file[name].shape
        del file[name]
        if value is not None:
            file[name] = value if np.ndim(value) else np.full(shape, value)
    try:
        problems = validate(copied)
    except DatasetError as error:
        problems = [str(error)]
    assert any(words in problem for problem in problems)


@pytest.mark.slow
def test_signals_do_not_depend_on_threads_or_on_other_views(path, tmp_path):
    try:
        set_threads(1)
        simulate(toy("geometry.views=1"), tmp_path / "one.h5")
    finally:
        set_threads(None)
    simulate(toy("geometry.views=2"), tmp_path / "two.h5")
    with (
        open_dataset(path) as first,
        open_dataset(tmp_path / "one.h5") as one,
        open_dataset(tmp_path / "two.h5") as two,
    ):
        np.testing.assert_array_equal(first.load([0]), one.load([0]))
        np.testing.assert_array_equal(first.load([0]), two.load([0]))
        assert (two.load([0]) != two.load([1])).any()


def test_a_reconstructor_gets_signals_whose_open_beam_variance_is_their_mean(path):
    with open_dataset(path) as dataset:
        measured = read_measurements(dataset, np.array([0]), bases=1)
        flats = dataset.file["entry/instrument/flat/data"][:, 0] / dataset.spectra.quantum[0]
    assert flats.var() / flats.mean() == pytest.approx(1.0, abs=5 * np.sqrt(2 / flats.size))
    assert flats.mean() == pytest.approx(measured.transmission.open_beam[0], rel=0.01)
    np.testing.assert_allclose(measured.gains, 1.0, atol=0.1)
    # Behind 20 cm of water photons are harder, and the variance is 22 % larger than the mean in these units.
    excess = measured.counts.var() / measured.counts.mean()
    assert 1.0 < excess < 1.4


def test_two_bases_need_more_than_one_channel(path):
    with open_dataset(path) as dataset, pytest.raises(InputError, match="1 channel cannot tell 2 bases apart"):
        read_measurements(dataset, np.array([0]))


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("detector.thickness=0", "detector.thickness - input should be greater than 0"),
        ("detector.thresholds=[20]", "detector.thresholds - unknown key"),
        ("detector.composition=CsJ", "unknown material 'CsJ'"),
        ("detector.composition=NaI", "needs a density"),
        ("detector={type: energy_integrating, composition: NaI, density: 3.67}", "needs a thickness in mm"),
        (
            "detector.type=integrating",
            "unknown type 'integrating': choose from 'photon_counting', 'energy_integrating'",
        ),
    ],
)
def test_impossible_detectors_are_refused(override, words):
    with pytest.raises(SceneError) as caught:
        toy(override)
    assert words in str(caught.value)
