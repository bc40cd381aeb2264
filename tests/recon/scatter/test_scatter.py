"""Estimates of scatter against what the simulator added, and reconstructions with and without them."""

import numpy as np
import pytest

import phantomgen
from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.truth import read_truth
from phantomgen.effects import ScatterKernel
from phantomgen.effects.smooth_signal import SmoothSignal
from recon.data.measurements import read_measurements
from recon.scatter.chosen_scatter import SCATTER, ChosenScatter, parse_scatter, read_scatter
from recon.scatter.compton import compton_signal
from recon.scatter.estimate import estimate_scatter
from recon.scatter.models import Compton, FittedKernel
from recon.voxel.iterative.one_step import OneStep
from spectra.errors import InputError

SMALL = [
    "geometry.views=24",
    "geometry.test_views=2",
    "panel={rows: 32, columns: 32, pitch: 6.4}",
    "volume.voxels=48",
]
EFFECTS = {"compton": "{type: compton}", "kernel": "{type: kernel, ratio: 0.3, width: 60}"}


def scan(folder, name: str, *changes: str) -> Dataset:
    scene = phantomgen.load("kedge-small", [*SMALL, *changes])
    return phantomgen.make(scene, out=folder / f"{name}.h5", overwrite=True)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("scatter")


@pytest.fixture(scope="module")
def plain(folder):
    with scan(folder, "plain", "noise=false") as dataset:
        yield dataset


@pytest.fixture(scope="module", params=EFFECTS)
def scattered(request, folder):
    with scan(folder, request.param, f"effects.scatter={EFFECTS[request.param]}", "noise=false") as dataset:
        yield request.param, dataset


@pytest.fixture(scope="module")
def compton(folder):
    with scan(folder, "noisy", "effects.scatter={type: compton}") as dataset:
        yield dataset


def errors(signal: SmoothSignal, dataset: Dataset, plain: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Relative error of the sum and rms error over the mean, of each channel."""
    views = [0, 7, 19]
    true = dataset.load(views).astype(float) - plain.load(views)
    found = np.stack([signal.image(view, *true.shape[2:]) for view in views])
    mean = true.mean(axis=(0, 2, 3))
    return found.mean(axis=(0, 2, 3)) / mean - 1, np.sqrt(((found - true) ** 2).mean(axis=(0, 2, 3))) / mean


@pytest.mark.slow
def test_true_volumes_scatter_as_the_scene_does(folder, plain):
    with scan(folder, "exact", "effects.scatter={type: compton}", "noise=false") as dataset:
        truth = read_truth(dataset.path)
        bias, rms = errors(compton_signal(dataset, truth.volumes, truth.grid), dataset, plain)
    assert np.abs(bias).max() < 0.08  # 10 x 10 x 10 cells where the simulator has 12 x 12 x 12
    assert rms.max() < 0.12


@pytest.mark.slow
def test_a_detector_that_sums_up_energies_measures_photons_that_have_lost_some(folder):
    one = ["source={type: monochromatic, energy: 60, photons: 1e6}", "detector={type: energy_integrating}"]
    one += ["noise=false", "panel={rows: 32, columns: 32, pitch: 12.8}"]
    with (
        scan(folder, "one", *one) as plain,
        scan(folder, "one-scattered", *one, "effects.scatter={type: compton}") as dataset,
    ):
        truth = read_truth(dataset.path)
        basis = dataset.spectra.basis
        signal = compton_signal(dataset, truth.volumes[: len(basis.functions)], truth.grid)
        bias, rms = errors(signal, dataset, plain)
        corner = signal.image(0, 32, 32)[0, 0, 0] / (dataset.load([0]).astype(float) - plain.load([0]))[0, 0, 0, 0]
    assert np.abs(bias).max() < 0.08
    assert rms.max() < 0.12
    assert corner == pytest.approx(1, abs=0.15)


@pytest.mark.slow
def test_reconstructed_volumes_scatter_so_too_and_a_kernel_is_inverted(scattered, plain):
    kind, dataset = scattered
    model = Compton() if kind == "compton" else ScatterKernel(0.3, 60.0)
    bias, _ = errors(estimate_scatter(dataset, model).signal, dataset, plain)
    assert np.abs(bias).max() < (0.12 if kind == "compton" else 0.03)


@pytest.mark.slow
def test_a_factor_is_found_in_the_counts(compton):
    found = float(estimate_scatter(compton, Compton(None)).fitted.split()[-1])
    assert found == pytest.approx(1.0, rel=0.15)


@pytest.mark.slow
def test_volumes_without_scatter_come_closer_to_the_truth(compton):
    truth = read_truth(compton.path)

    def error(dataset: Dataset) -> np.ndarray:
        measured = read_measurements(dataset, dataset.splits["train"]).without_partial_volume()
        volumes = OneStep(levels=((2, 6), (1, 6))).reconstruct_counts(measured.compressed(1e-3)[0], dataset.grid)
        return np.sqrt(((volumes - truth.volumes) ** 2).mean(axis=(1, 2, 3)))

    corrected = ChosenScatter.of(compton, Compton()).dataset
    assert (error(corrected) < error(compton)).all()
    assert error(corrected)[0] < 0.6 * error(compton)[0]


def test_counts_lose_the_scatter_and_weights_the_part_of_its_noise(compton):
    counts, channels = compton.counts.shape, compton.counts.shape[1]
    signal = SmoothSignal(np.full((counts[0], channels, 3, 3), 50.0))
    with_noise, without = (read_measurements(d, np.array([0, 5])) for d in (compton, compton.with_scatter(signal)))
    gain = with_noise.gains * with_noise.exposure[0][:, None, None]
    assert without.counts[0] == pytest.approx(np.maximum(with_noise.counts[0] - 50 * gain, 0), rel=1e-5, abs=1e-2)
    ratio = without.weighted(0.0).statistical_weights / np.maximum(with_noise.weighted(0.0).statistical_weights, 1e-9)
    air = np.s_[:, :, :2, :2]  # a corner that sees no object, where all weights are 1 without scatter
    expected = without.counts[air] / (without.counts[air] + 50 * gain[:, :2, :2])
    assert ratio[air] == pytest.approx(expected, rel=0.05)


def test_scatter_of_summed_pixels_is_the_sum(compton):
    rng = np.random.default_rng(0)
    signal = SmoothSignal(rng.uniform(10, 20, (*compton.counts.shape[:2], 4, 4)))
    measured = read_measurements(compton.with_scatter(signal), np.array([3]))
    blocks = measured.scattered(0).reshape(4, 16, 2, 16, 2).sum(axis=(2, 4))
    assert measured.summed(2).scattered(0) == pytest.approx(blocks, rel=0.02)


def test_an_estimate_is_kept_in_the_run_folder(compton, tmp_path):
    signal = SmoothSignal(np.random.default_rng(1).uniform(size=(*compton.counts.shape[:2], 3, 3)))
    ChosenScatter(compton.with_scatter(signal)).write(tmp_path / SCATTER)
    assert ChosenScatter.of_run(compton, tmp_path).dataset.scatter.values == pytest.approx(signal.values, rel=1e-6)
    assert ChosenScatter.of_run(compton, tmp_path.parent).dataset.scatter is None


@pytest.mark.parametrize("content", ["damaged", "other"])
def test_a_file_that_does_not_fit_is_refused(compton, tmp_path, content):
    path = tmp_path / SCATTER
    if content == "damaged":
        path.write_bytes(b"nothing")
    else:
        ChosenScatter(compton.with_scatter(SmoothSignal(np.ones((1, 1, 3, 3))))).write(path)
    with pytest.raises(InputError, match=r"cannot be read as an estimate|must begin with the 26 views and 4 channels"):
        read_scatter(path, compton)


@pytest.mark.parametrize(
    ("text", "model"),
    [
        (None, None),
        ("compton", Compton()),
        ("compton:1.4", Compton((1.4,))),
        ("compton:1.4,1,0.7", Compton((1.4, 1.0, 0.7))),
        ("compton:fit", Compton(None)),
        ("compton:fit-channels", Compton(None, each_channel=True)),
        ("kernel:0.3,60", ScatterKernel(0.3, 60.0)),
        ("kernel:fit,60", FittedKernel(60.0)),
        ("kernel:fit-channels,60", FittedKernel(60.0, each_channel=True)),
    ],
)
def test_options_name_models(text, model):
    assert parse_scatter(text) == model


@pytest.mark.parametrize(
    "text", ["rayleigh", "compton:fit,2", "compton:x", "kernel:0.3", "kernel:0.3,fit", "kernel:fit", "kernel:"]
)
def test_other_options_are_refused_with_the_forms(text):
    with pytest.raises(InputError, match="--scatter takes compton, compton:FACTOR"):
        parse_scatter(text)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("compton:-1", "must be finite and not negative, got -1"),
        ("kernel:0.3,0", "must be positive"),
        ("kernel:fit,0", "must be positive"),
    ],
)
def test_numbers_out_of_range_are_refused(text, words):
    with pytest.raises(InputError, match=words):
        parse_scatter(text)


def test_as_many_factors_as_channels_are_needed(compton):
    with pytest.raises(InputError, match="2 factors of scatter do not suit the 4 channels"):
        estimate_scatter(compton, Compton((1.0, 2.0)))


@pytest.mark.slow
def test_the_ratio_of_a_kernel_is_found_in_the_counts(folder, plain):
    with scan(folder, "kernel", f"effects.scatter={EFFECTS['kernel']}", "noise=false") as dataset:
        found = estimate_scatter(dataset, FittedKernel(60.0))
        bias, _ = errors(found.signal, dataset, plain)
    assert float(found.fitted.split()[-1]) == pytest.approx(0.3, rel=0.1)
    assert np.abs(bias).max() < 0.1


def test_parallel_rays_need_a_kernel(folder):
    changes = ["geometry={type: parallel, distance: 150, views: 8, test_views: 1}"]
    with scan(folder, "parallel", *changes) as dataset, pytest.raises(InputError, match="take a kernel"):
        estimate_scatter(dataset, Compton())
