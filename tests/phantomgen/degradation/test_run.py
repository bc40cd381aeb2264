"""Worse files: what they hold, that they are valid, and that one seed gives one file."""

import h5py
import numpy as np
import pytest
from support.tiny_scans import make

import phantomgen
from phantomgen.dataset.describe import describe
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.true_poses import read_true_geometry
from phantomgen.dataset.validate import validate
from phantomgen.degradation.run import degrade_file
from phantomgen.degradation.settings import Degradation
from phantomgen.geometry.panel_changes import smaller_panel
from spectra.errors import InputError
from spectra.threads import set_threads

TRUTH = ("basis/data", "fractions", "labels", "materials/coefficients", "scene/data", "plan/data")
DEFECTS = "effects.defects={dead: 0.02, hot: 0.02}"


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    path = tmp_path_factory.mktemp("degrade") / "scan.h5"
    return make(path, "--views", "12", "--test-views", "3", "--set", DEFECTS, "--keep", "expected")


@pytest.fixture(scope="module")
def signals(tmp_path_factory):
    path = tmp_path_factory.mktemp("degrade") / "signals.h5"
    detector = ("--set", "detector={type: energy_integrating}", "--set", "darks=20")
    return make(path, "--views", "6", "--set", "effects.electronics={sigma: 2000, offset: 9000}", *detector)


def degraded(scan, tmp_path, name="low.h5", **options):
    return degrade_file(scan, tmp_path / name, Degradation(**options)).path


def counts(path):
    with open_dataset(path) as dataset:
        return dataset.load().astype(np.int64)


def test_everything_at_once_is_a_valid_dataset_with_the_same_truth(scan, tmp_path):
    path = degraded(
        scan,
        tmp_path,
        dose=0.25,
        views=4,
        arc=(0, 180),
        truncate=0.25,
        bin=2,
        dead=0.05,
        shift=0.5,
        tilt=0.3,
        kv_error=2.0,
    )
    assert validate(path) == []
    with open_dataset(path) as low, open_dataset(scan) as full:
        assert low.counts.shape == (7, 4, 16, 12)
        assert [len(low.splits[name]) for name in ("train", "test")] == [4, 3]
        assert low.exposure == pytest.approx(0.25)
        for name in TRUTH:
            assert np.array_equal(low.file[f"truth/{name}"][()], full.file[f"truth/{name}"][()])
        test = full.splits["test"]
        whole = smaller_panel(full.geometry[test], slice(4, 28), 2)
        assert read_true_geometry(path)[low.splits["test"]] == whole
        nominal, cosine = low.geometry[low.splits["test"]], np.cos(np.deg2rad(0.3))
        assert nominal.panel_center - whole.panel_center == pytest.approx(0.5 * whole.column_step)
        assert np.sum(nominal.column_step * whole.column_step) == pytest.approx(cosine * np.sum(whole.column_step**2))
        assert low.file["entry/instrument/source/voltage"][()] == full.file["entry/instrument/source/voltage"][()] + 2
    steps = describe(path)["history"]
    assert [(step["number"], step["step"], step["seed"]) for step in steps] == [(2, "degrade", 0)]
    assert steps[0]["done"][0] == "dose 0.25: binomial thinning of counts; flats as measured, exposure scaled"
    assert steps[0]["done"][1] == "views: 4 of 12 training views from 0 to 180 degrees; 3 test kept"


def test_one_seed_gives_one_file_whatever_the_threads(scan, tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    files = []
    for threads in (1, 2):
        set_threads(threads)
        files.append(degraded(scan, tmp_path, f"{threads}.h5", dose=0.3, bin=2, dead=0.02, seed=5).read_bytes())
    set_threads(None)
    assert files[0] == files[1]


def test_the_noise_of_a_view_does_not_depend_on_which_others_are_left(scan, tmp_path):
    all_views = counts(degraded(scan, tmp_path, "all.h5", dose=0.3, seed=1))
    few = counts(degraded(scan, tmp_path, "few.h5", dose=0.3, seed=1, views=3, truncate=0.5))
    assert np.array_equal(few, all_views[[0, 4, 8, 12, 13, 14], :, :, 8:24])
    other = counts(degraded(scan, tmp_path, "other.h5", dose=0.3, seed=2))
    assert not np.array_equal(other, all_views)


def test_a_file_and_its_complement_are_the_scan(scan, tmp_path):
    kept = counts(degraded(scan, tmp_path, "kept.h5", dose=0.3))
    rest = counts(degraded(scan, tmp_path, "rest.h5", dose=0.3, complement=True))
    with open_dataset(scan) as dataset:
        measuring = ~dataset.mask
        full = dataset.load()
        assert np.array_equal((kept + rest)[:, measuring], full[:, measuring])
        assert np.array_equal(kept[:, dataset.mask], full[:, dataset.mask])
    with open_dataset(tmp_path / "rest.h5") as dataset:
        assert dataset.exposure == pytest.approx(0.7)


def test_low_doses_agree_with_the_expected_counts_and_their_flats(scan, tmp_path):
    """Chi-square of all counts against 0.1 times the noise-free ones, which the simulator stored."""
    path = degraded(scan, tmp_path, dose=0.1, bin=2)
    with open_dataset(path) as dataset:
        expected = dataset.file["truth/expected"][()]
        good = np.broadcast_to(~dataset.mask, expected.shape) & (expected > 20)
        chi = (dataset.load() - expected)[good] / np.sqrt(expected[good])
        assert chi.mean() == pytest.approx(0, abs=5 / np.sqrt(chi.size))
        assert (chi**2).mean() == pytest.approx(1, abs=5 * np.sqrt(2.1 / chi.size))
        air = (dataset.exposure[0][:, None, None] * dataset.flat)[~dataset.mask]
    with open_dataset(scan) as dataset:
        assert air.mean() == pytest.approx(0.4 * dataset.flat[~dataset.mask].mean(), rel=0.01)


def test_thinned_flats_leave_the_exposure_and_lower_the_stated_photons(scan, tmp_path):
    path = degraded(scan, tmp_path, dose=0.25, flats="thin")
    with open_dataset(path) as low, open_dataset(scan) as full:
        assert low.exposure == pytest.approx(full.exposure)
        assert low.spectra.source == pytest.approx(0.25 * full.spectra.source)
        good = ~full.mask
        assert low.flat[good].sum() == pytest.approx(0.25 * full.flat[good].sum(), rel=1e-3)


def test_a_scan_can_be_degraded_twice_with_one_seed(scan, tmp_path):
    once = degraded(scan, tmp_path, "once.h5", dose=0.5)
    twice = degraded(once, tmp_path, "twice.h5", dose=0.5)
    steps = describe(twice)["history"]
    assert [step["number"] for step in steps] == [2, 3]
    with open_dataset(twice) as dataset:
        assert dataset.exposure == pytest.approx(0.25)
        expected = dataset.file["truth/expected"][()]
        good = np.broadcast_to(~dataset.mask, expected.shape) & (expected > 20)
        chi = (dataset.load() - expected)[good] ** 2 / expected[good]
        assert chi.mean() == pytest.approx(1, abs=5 * np.sqrt(2.1 / chi.size))


def test_dead_pixels_read_nothing_anywhere_and_are_marked(scan, tmp_path):
    path = degraded(scan, tmp_path, dead=0.1, seed=3)
    with open_dataset(path) as low, open_dataset(scan) as full:
        new = low.mask[0] & ~full.mask[0]
        assert low.mask[0].sum() >= round(0.1 * 32 * 32)
        assert np.array_equal(low.mask[0] | full.mask[0], low.mask[0])
        assert not low.load()[:, :, new].any()
        assert not low.flat[:, new].any()
        assert np.array_equal(low.load()[:, :, ~low.mask[0]], full.load()[:, :, ~low.mask[0]])


def test_dead_columns_are_dead_from_end_to_end_and_marked(scan, tmp_path):
    with open_dataset(degraded(scan, tmp_path, dead_columns=3, seed=3)) as worse, open_dataset(scan) as full:
        new = worse.mask[0] & ~full.mask[0]
        assert np.count_nonzero(worse.mask[0].all(axis=0)) == 3
        assert not worse.load()[:, :, worse.mask[0].all(axis=0)[None].repeat(32, 0)].any()
        assert np.array_equal(worse.load()[:, :, ~new], full.load()[:, :, ~new])


def test_hot_pixels_read_twice_the_open_beam_everywhere_and_are_not_marked(scan, tmp_path):
    with open_dataset(degraded(scan, tmp_path, hot=0.05, seed=3)) as worse, open_dataset(scan) as full:
        assert np.array_equal(worse.mask, full.mask)
        changed = (worse.load() != full.load()).any(axis=(0, 1))
        assert np.count_nonzero(changed) == pytest.approx(0.05 * 32 * 32, abs=3)  # some were hot before
        level = np.rint(2 * np.median(full.flat, axis=(1, 2)))[:, None]
        assert (worse.load()[:, :, changed] == level).all()
        for kind in ("flat", "dark"):
            assert (worse.file[f"entry/instrument/{kind}/data"][:][:, :, changed] == level).all()


def test_correct_finds_hot_pixels(scan, tmp_path):
    clean = degraded(make(tmp_path / "clean.h5", "--views", "12"), tmp_path, hot=0.02)
    with phantomgen.correct(clean, tmp_path / "mended.h5", ("defects",)) as mended:
        assert np.count_nonzero(mended.mask[0]) == round(0.02 * 32 * 32)


def test_readings_of_views_end_where_pixels_saturate(scan, tmp_path):
    done = degrade_file(scan, tmp_path / "full.h5", Degradation(saturate=0.5))
    assert done.history == ("panel: readings of the views end at 0.5 times the open beam",)
    with open_dataset(done.path) as worse, open_dataset(scan) as before:
        limits = np.floor(0.5 * np.median(before.flat, axis=(1, 2)))[:, None, None]
        assert np.array_equal(worse.load(), np.minimum(before.load(), limits))
        assert (worse.load() == limits).any()
        assert np.array_equal(worse.flat, before.flat)


def test_a_drifting_tube_loses_photons_that_the_file_does_not_state(scan, tmp_path):
    done = degrade_file(scan, tmp_path / "low.h5", Degradation(drift=0.2))
    assert done.history == ("tube output: falls by 0.2 of it from the first to the last view, not stated",)
    with open_dataset(done.path) as low, open_dataset(scan) as full:
        assert np.array_equal(low.exposure, full.exposure)
        ratio = low.load().sum(axis=(1, 2, 3)) / full.load().sum(axis=(1, 2, 3))
        left = 1 - 0.2 * np.arange(len(ratio)) / (len(ratio) - 1)
        hot = np.count_nonzero(full.mask[0]) / full.mask[0].size  # masked pixels keep what they read
        assert ratio == pytest.approx(left, abs=0.2 * 3 * hot + 0.01)
        assert np.array_equal(low.load([0]), full.load([0]))
        assert np.array_equal(low.flat, full.flat)
        expected = low.file["truth/expected"][:]
        good = np.broadcast_to(~low.mask, expected.shape) & (expected > 20)
        chi = (low.load() - expected)[good] ** 2 / expected[good]
        assert chi.mean() == pytest.approx(1, abs=5 * np.sqrt(2.1 / chi.size))


def test_means_become_poisson_counts_of_any_dose(tmp_path):
    exact = make(tmp_path / "exact.h5", "--views", "4", "--no-noise")
    scaled = degraded(exact, tmp_path, "scaled.h5", dose=0.5)
    with open_dataset(scaled) as low, open_dataset(exact) as full:
        assert low.load() == pytest.approx(0.5 * full.load(), rel=1e-6)
    noisy = degraded(exact, tmp_path, "noisy.h5", dose=0.01, noise=True)
    with open_dataset(noisy) as low, open_dataset(exact) as full:
        assert low.counts.dtype == np.int32
        mean = 0.01 * full.load().astype(float)
        chi = (low.load() - mean)[mean > 20] ** 2 / mean[mean > 20]
        assert chi.mean() == pytest.approx(1, abs=5 * np.sqrt(2.1 / chi.size))


def test_signals_have_the_noise_of_a_scan_of_the_lower_dose(signals, tmp_path):
    """Differences of many pixels of air against a simulation of a tenth of the photons."""
    low = degraded(signals, tmp_path, dose=0.1, flats="thin")
    with h5py.File(low) as file, h5py.File(signals) as full:
        flats, darks = (file[f"entry/instrument/{kind}/data"][()].astype(float) for kind in ("flat", "dark"))
        whole = full["entry/instrument/flat/data"][()].astype(float)
        assert np.array_equal(darks, full["entry/instrument/dark/data"][()])
    electronics = darks.var(axis=0, ddof=1).mean()
    signal = flats.mean() - darks.mean()
    assert signal == pytest.approx(0.1 * (whole.mean() - darks.mean()), rel=2e-3)
    quantum = (whole.var(axis=0, ddof=1).mean() - electronics) / (whole.mean() - darks.mean())
    assert flats.var(axis=0, ddof=1).mean() == pytest.approx(quantum * signal + electronics, rel=0.03)


def test_dead_time_is_refused_at_lower_doses_and_shared_by_binned_pixels(tmp_path):
    counter = "detector.dead_time={tau_ns: 100, exposure_ms: 100}"
    busy = make(tmp_path / "busy.h5", "--views", "4", "--set", counter)
    with pytest.raises(InputError, match="fewer are lost at a lower dose"):
        degraded(busy, tmp_path, dose=0.5)
    assert not (tmp_path / "low.h5").exists()
    binned = degraded(busy, tmp_path, "binned.h5", bin=2)
    with open_dataset(binned) as low, open_dataset(busy) as full:
        assert low.spectra.dead_time.tau_ns == full.spectra.dead_time.tau_ns / 4
        rates = full.spectra.dead_time.corrected(full.flat)
        summed = rates.reshape(4, 16, 2, 16, 2).sum(axis=(2, 4))
        assert low.spectra.dead_time.corrected(low.flat) == pytest.approx(summed, rel=1e-4)


def test_python_writes_and_opens(scan, tmp_path):
    with phantomgen.open(scan) as full, phantomgen.degrade(full, tmp_path / "low.h5", dose=0.5, views=6) as low:
        assert low.counts.shape[0] == 9
    settings = phantomgen.Degradation(views=6)
    with phantomgen.degrade(scan, tmp_path / "low.h5", settings, bin=2, overwrite=True) as low:
        assert low.counts.shape == (9, 4, 16, 16)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"dose": 1.01}, "a dose must lie above 0 and be at most 1, got 1.01"),
        ({"dose": 0.0}, "a dose must lie above 0"),
        ({"views": 13}, "there are 12 training views"),
        ({"views": 0}, "at least one training view"),
        ({"arc": (1.0, 2.0)}, "holds no training view"),
        ({"arc": (20.0, 10.0)}, "two angles that ascend"),
        ({"bin": 3}, "32 x 32 pixels cannot be binned by 3: 2, 4, 8, 16, 32 would"),
        ({"truncate": 1.0}, "must lie in 0 .. 1"),
        ({"dead": 0.6}, "the part of dead pixels must lie in 0 .. 0.5"),
        ({"hot": 0.6}, "the part of hot pixels must lie in 0 .. 0.5"),
        ({"dead_columns": 40}, "dead columns must lie in 0 .. 32, got 40"),
        ({"dead_columns": -1}, "dead columns must lie in 0 .. 32, got -1"),
        ({"saturate": -0.5}, "pixels saturate at a reading above 0, in open beams, got -0.5"),
        ({"drift": 1.0}, "drifts away must lie in 0 .. 1, got 1"),
        ({"drift": 0.1, "dose": 0.5, "complement": True}, "leave out the drift"),
        ({"noise": True}, "has noise already"),
        ({"complement": True}, "the complement of dose 1"),
        ({"kv_error": -135.0}, "a tungsten tube works from 10"),
        ({"shift": float("nan")}, "shift must be finite"),
    ],
)
def test_what_cannot_be_done_is_one_sentence_and_leaves_nothing(scan, tmp_path, options, words):
    with pytest.raises(InputError, match=words) as caught:
        degraded(scan, tmp_path, **options)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_scan_is_not_written_over_itself(scan):
    with pytest.raises(InputError, match="is the scan itself"):
        degrade_file(scan, scan, Degradation(dose=0.5), overwrite=True)
