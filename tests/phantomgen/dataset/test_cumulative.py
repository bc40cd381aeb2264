"""Datasets with counts above thresholds: the same scan as one with counts between them, for all that read it."""

import numpy as np
import pytest
from support.detector_scenes import counting
from support.edited_datasets import edited_dataset

import phantomgen
from phantomgen.dataset.adapters.to_projections import to_projections
from phantomgen.dataset.describe import describe, describe_text
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.validate import validate
from phantomgen.simulation.run import simulate
from spectra.errors import DatasetError, SceneError

SETTINGS = ["geometry.views=3", "flats=3", "detector.thresholds=[20, 45, 65]"]
CUMULATIVE = "detector.counters=cumulative"


def scan(path, *settings):
    simulate(counting(*SETTINGS, *settings), path, keep_expected=True)
    return path


@pytest.fixture
def pair(tmp_path):
    return scan(tmp_path / "bins.h5"), scan(tmp_path / "counters.h5", CUMULATIVE)


def test_counters_are_read_as_channels_between_thresholds(pair):
    bins, counters = map(open_dataset, pair)
    with bins, counters, open_dataset(pair[1], as_stored=True) as stored:
        assert np.array_equal(bins.load(), counters.load())
        assert np.array_equal(bins.flat, counters.flat)
        assert np.array_equal(bins.line_integrals(1), counters.line_integrals(1))
        assert np.array_equal(bins.spectra.upper, counters.spectra.upper)
        np.testing.assert_allclose(counters.spectra.response, bins.spectra.response, atol=1e-15)
        assert np.array_equal(stored.load(), np.array(stored.counts))
        assert (np.diff(stored.load(), axis=1) <= 0).all()
        np.testing.assert_allclose(stored.spectra.response[0], bins.spectra.response.sum(axis=0))
        assert set(stored.spectra.upper) == {bins.spectra.upper[-1]}
        for kind in ("counts", "line-integrals"):
            exported = [to_projections(one, kind) for one in (bins, counters)]
            assert np.array_equal(*(projections.image(2) for projections in exported), equal_nan=True)
    assert validate(pair[1]) == []
    assert "counters   cumulative" in describe_text(describe(pair[1]))
    assert "counters " not in describe_text(describe(pair[0]))


def test_expected_counts_are_cumulative_too(pair):
    with open_dataset(pair[0]) as bins, open_dataset(pair[1], as_stored=True) as stored:
        each, above = (dataset.file["truth/expected"][()] for dataset in (bins, stored))
    np.testing.assert_allclose(above[:, 0], each.sum(axis=1), rtol=1e-6)


def test_dead_time_belongs_to_the_pixel(tmp_path):
    dead_time = "detector.dead_time={tau_ns: 100, exposure_ms: 0.5}"
    bins, counters = scan(tmp_path / "a.h5", dead_time), scan(tmp_path / "b.h5", dead_time, CUMULATIVE)
    with open_dataset(bins) as one, open_dataset(counters) as other:
        assert one.spectra.dead_time is not None
        assert np.array_equal(one.line_integrals(0), other.line_integrals(0))
    with open_dataset(counters, as_stored=True) as stored, open_dataset(bins) as one:
        events = stored.spectra.events(stored.flat)
        np.testing.assert_allclose(events[0], one.spectra.events(one.flat).sum(axis=0))


def test_a_channel_lacks_a_pixel_where_one_of_its_counters_does(tmp_path):
    path = scan(tmp_path / "scan.h5", CUMULATIVE)
    mask = np.zeros((40, 48), np.uint32)
    mask[3, 4] = 1
    with edited_dataset(path) as file:
        file["entry/instrument/detector/counter1_channel/pixel_mask"] = mask
    with open_dataset(path) as dataset:
        assert dataset.mask[:, 3, 4].tolist() == [True, True, False]
        assert dataset.mask.sum() == 2


def test_a_lower_dose_keeps_counters_in_order(pair, tmp_path):
    kept = phantomgen.degrade(pair[1], tmp_path / "kept.h5", dose=0.25)
    other = phantomgen.degrade(pair[1], tmp_path / "other.h5", dose=0.25, complement=True)
    with kept, other, open_dataset(pair[0]) as bins:
        assert kept.subtracts
        assert np.array_equal(kept.load() + other.load(), bins.load())
        assert kept.load().min() >= 0
        assert kept.load().mean() == pytest.approx(0.25 * bins.load().mean(), rel=0.01)


def test_corrections_keep_counters_as_they_are(pair, tmp_path):
    with phantomgen.correct(pair[1], tmp_path / "out.h5", steps=("rings",)) as corrected:
        assert corrected.subtracts
        with open_dataset(pair[1]) as before:
            assert np.array_equal(corrected.load(), before.load())
            np.testing.assert_allclose(corrected.flat.mean(), before.flat.mean(), rtol=1e-3)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("entry/instrument/detector/counters", "sums", "must be 'cumulative' or 'bins', found 'sums'"),
        ("entry/exposure/scale", np.array([[1.0, 1.0, 0.5]] * 3), "the same exposure scale in all channels"),
        ("entry/instrument/detector/counter1_channel/threshold_energy", 90.0, "thresholds that ascend"),
    ],
)
def test_counters_that_cannot_be_subtracted_are_refused(tmp_path, name, value, words):
    path = scan(tmp_path / "scan.h5", CUMULATIVE)
    with edited_dataset(path) as file:
        del file[name]
        file[name] = value
    with pytest.raises(DatasetError, match=words):
        open_dataset(path)


def test_several_sources_have_no_cumulative_counters():
    tubes = "low: {type: tube, kvp: 80, photons: 1e4}, high: {type: tube, kvp: 140, photons: 1e4}"
    sources = f"source={{type: switching, sources: {{{tubes}}}}}"
    with pytest.raises(SceneError, match="may be cumulative with a single source only"):
        counting(CUMULATIVE, sources)
