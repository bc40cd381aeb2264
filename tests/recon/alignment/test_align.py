"""Alignment: errors of a stated panel are found from the projections, with an honest uncertainty."""

import numpy as np
import pytest
from support.tiny_scans import make

from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.true_poses import read_true_geometry
from recon.alignment.align import align
from recon.alignment.estimate import gauss_newton, misfit
from recon.alignment.interface import align as align_file
from recon.alignment.levels import Level, factors
from recon.alignment.log_projections import SummedCounts
from recon.alignment.panel_errors import changed
from recon.alignment.projected_out import explain
from spectra.errors import InputError


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    path = tmp_path_factory.mktemp("align") / "scan.h5"
    return make(path, "--views", "24", "--test-views", "2", rows=24, columns=24)


def wrong(dataset, columns: float, tilt: float):
    """The scan with an error of its stated panel."""
    return dataset._with(geometry=changed(dataset.geometry, np.array([columns, tilt])))


@pytest.mark.parametrize(("columns", "tilt"), [(0.4, 0.5), (-3.2, -1.0), (0.0, 0.0)])
@pytest.mark.slow
def test_shift_and_tilt_are_found_within_a_twentieth_of_a_pixel(scan, columns, tilt):
    with open_dataset(scan) as dataset:
        found = align(wrong(dataset, columns, tilt))
    expected = np.array([-np.cos(np.deg2rad(tilt)) * columns, -tilt])
    assert found.change == pytest.approx(expected, abs=0.05)  # 0.05 degrees are 0.01 pixel at the edge of 32 columns
    assert (np.abs(found.change - expected) < 4 * found.uncertainty + 0.005).all()
    assert found.misfit[1] <= found.misfit[0] * 1.001


def test_what_is_not_asked_for_stays(scan):
    with open_dataset(scan) as dataset:
        found = align(wrong(dataset, 1.0, 0.0), ("columns",))
    assert found.change[1] == 0
    assert np.isnan(found.uncertainty[1])
    assert found.change[0] == pytest.approx(-1.0, abs=0.05)
    assert "not estimated" in found.sentences[-1]


@pytest.mark.slow
def test_the_copy_has_corrected_poses_the_same_counts_and_the_old_truth(scan, tmp_path):
    out = tmp_path / "aligned.h5"
    found = align_file(scan, out)
    with open_dataset(scan) as before, open_dataset(out) as after:
        assert (before.load() == after.load()).all()
        assert after.geometry == found.geometry
        assert read_true_geometry(out) == before.geometry
        done = [name for name in after.file["entry"] if name.startswith("process_")]
    assert sorted(done) == ["process_1_simulate", "process_2_align"]
    with pytest.raises(InputError, match="is the scan itself"):
        align_file(scan, scan)
    with pytest.raises(InputError, match="exists"):
        align_file(scan, out)


def test_too_few_views_and_unknown_names_are_refused(scan):
    with open_dataset(scan) as dataset:
        with pytest.raises(InputError, match="at least 8"):
            align(dataset.with_training_views(7))
        with pytest.raises(InputError, match=r"estimates columns, tilt, got 'pitch'"):
            align(dataset, ("pitch",))
        with pytest.raises(InputError, match="name something"):
            align(dataset, ())


@pytest.mark.slow
def test_masked_pixels_do_not_matter(scan):
    with open_dataset(scan) as dataset:
        mask = dataset.mask.copy()
        mask[:, 10:12, 14:18] = True
        found = align(wrong(dataset, 0.4, 0.5)._with(mask=mask))
        assert SummedCounts.of(dataset._with(mask=mask), np.arange(2)).air[:, 10:12, 14:18].max() == 0
    assert found.change == pytest.approx([-0.4, -0.5], abs=0.05)


def test_channels_with_gains_of_their_own_sum_to_the_same_log_projections(scan):
    random = np.random.default_rng(0)
    with open_dataset(scan) as dataset:
        gain = 1 + 0.2 * random.random(dataset.flat.shape)
        counts = dataset.load([0])[0]
        plain = SummedCounts.of(dataset, np.arange(1))
        flat = dataset.flat * gain
        scaled = dataset._with(flat=flat)
        vars(scaled)["load"] = lambda views: (counts * gain)[None]
        other = SummedCounts.of(scaled, np.arange(1))
    before, after = (np.log(one.air / one.counts)[0] for one in (plain, other))
    summed = np.log(flat.sum(axis=0) / (counts * gain).sum(axis=0))
    # the median share of a channel differs a little with its gains
    assert np.abs(after - before).max() < 0.2 * np.abs(summed - before).max()


def test_explaining_is_linear_and_leaves_nothing_of_a_projection(scan):
    with open_dataset(scan) as dataset:
        level = Level.of(SummedCounts.of(dataset, dataset.splits["train"]), 2)
    pair, weights = level.pair(np.zeros(2)), level.data[1]
    volume = np.zeros((1, *pair.grid.shape), np.float32)
    middle = tuple(slice(n // 3, 2 * n // 3) for n in pair.grid.shape)
    volume[0][middle] = 0.02
    image = pair.project(volume)
    left = explain(image, pair, weights, 60).rest
    assert np.sqrt(np.mean(left**2)) < 0.03 * np.sqrt(np.mean(image**2))
    both = explain(np.concatenate([image, 2 * image]), pair, weights, 20)
    assert both.rest[1] == pytest.approx(2 * both.rest[0], abs=1e-4)


def test_blocks_halve_from_coarse_to_fine():
    assert factors(128, 128) == [8, 4]
    assert factors(1000, 800) == [50, 25]
    assert factors(30, 30) == [1] or factors(30, 30)[-1] == 1
    assert factors(64, 1)[-1] == 1
    assert factors(128, 128, finest=1) == [8, 4, 2, 1]


def test_the_misfit_is_least_at_the_estimate(scan):
    with open_dataset(scan) as dataset:
        level = Level.of(SummedCounts.of(wrong(dataset, 0.6, 0.0), dataset.splits["train"]), 1)
    found = gauss_newton(level, np.zeros(2), (0,)).change
    here = misfit(level, found)
    assert all(misfit(level, found + np.array([step, 0.0])) > here for step in (-0.5, 0.5))
