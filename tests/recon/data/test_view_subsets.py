"""Some of the views stand for all of them, also where tube voltages are switched."""

import numpy as np
import pytest
from support.tiny_scans import make

import recon
from phantomgen.dataset.reader import open_dataset
from recon.data.measurements import read_measurements
from recon.data.view_subsets import (
    evenly_spread_views,
    every_nth_view,
    golden_section_order,
    interleaved_subsets,
    view_groups,
)
from recon.gaussians.recipe import Stage
from recon.kedge.rays import rays_away_from_edges

VOLTAGES = {"a": 80, "b": 140, "c": 110}


def switched(count):
    tubes = ", ".join(
        f"{name}: {{type: tube, kvp: {kvp}, filters: [{{composition: Al, thickness: 2.5}}], photons: 2.0e+5}}"
        for name, kvp in list(VOLTAGES.items())[:count]
    )
    detector = "detector={type: photon_counting, composition: CdTe, thickness: 1.6, thresholds: [20, 50]}"
    return ["--set", f"source={{type: switching, sources: {{{tubes}}}}}", "--set", detector]


@pytest.mark.parametrize("count", [1, 2, 3, 4])
@pytest.mark.parametrize("views", [9, 45, 64, 200])
def test_every_kind_of_view_is_taken_from(count, views):
    kinds = np.arange(views) % count
    assert (
        set(kinds[every_nth_view(kinds, 8)])
        == set(kinds[every_nth_view(kinds, 3.236)])
        == set(kinds[evenly_spread_views(kinds, 12)])
        == set(kinds)
    )
    assert len(every_nth_view(kinds, 8)) == pytest.approx(views / 8, abs=count)
    parts = interleaved_subsets(kinds, 6)
    assert sorted(np.concatenate(parts)) == list(range(views))
    if views >= 12 * count:
        assert all(set(kinds[part]) == set(kinds) for part in parts)


def test_views_of_one_kind_are_evenly_spread():
    kinds = np.zeros(45, int)
    np.testing.assert_array_equal(every_nth_view(kinds, 8), np.arange(0, 45, 8))
    np.testing.assert_array_equal(every_nth_view(kinds, 3.236), np.arange(0, 45, 3.236).astype(int))
    np.testing.assert_array_equal(evenly_spread_views(kinds, 12), np.linspace(0, 45, 12, endpoint=False).astype(int))
    np.testing.assert_array_equal(interleaved_subsets(kinds, 5)[2], np.arange(2, 45, 5))


@pytest.mark.parametrize("count", [2, 3])
def test_scans_with_switched_voltages_are_fitted(tmp_path, count):
    path = make(tmp_path / "switched.h5", "--views", "24", "--test-views", "3", *switched(count))
    told = []
    recipe = recon.Recipe(stages=(Stage(1.0, 1.0),), voxel_passes=1, approximation=2)
    fit = recon.fit(path, recipe, bases=2, callbacks=[lambda progress: told.append(progress.deviance)])
    assert np.isfinite(fit.volume()).all()
    assert np.mean(told[-count:]) < np.mean(told[:count])
    with open_dataset(path) as dataset:
        rays = rays_away_from_edges(dataset)
        measured = read_measurements(dataset, dataset.splits["train"], 2)
    assert (rays.gains > 0).any(axis=0).all()
    some = every_nth_view(view_groups(measured.exposure), 8)
    np.testing.assert_array_equal(measured.completed(some).counts, measured.completed().counts[some])


def test_a_channel_that_no_view_has_stays_unmeasured(tmp_path):
    path = make(tmp_path / "switched.h5", "--views", "8", "--test-views", "2", *switched(2))
    with open_dataset(path) as dataset:
        measured = read_measurements(dataset, dataset.splits["train"][::2], 2)
    np.testing.assert_array_equal(measured.completed().exposure.any(axis=0), [True, True, False, False])


@pytest.mark.parametrize("count", [1, 2, 3, 7, 10, 25, 90])
def test_subsequent_subsets_are_about_the_golden_section_apart(count):
    order = golden_section_order(count)
    assert sorted(order) == list(range(count))
    if count > 20:
        steps = np.diff(order) % count
        assert len(set(steps)) == 1
        assert 0.35 * count <= steps[0] <= 0.45 * count
