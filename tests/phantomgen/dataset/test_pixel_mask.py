"""Pixel masks in datasets: written as NeXus says, read back, checked, and left out of what air says."""

import numpy as np
import pytest
from support.detector_scenes import counting, integrating, views_of
from support.edited_datasets import edited_dataset

from phantomgen.dataset.describe import describe, describe_text
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.validate import validate
from phantomgen.simulation.run import simulate
from spectra.errors import DatasetError, InputError

SETTINGS = ["geometry.views=2", "effects.defects={dead: 0.05, hot: 0.02, columns: [2]}"]
FIELD = "entry/instrument/detector/{}_channel/pixel_mask"


@pytest.fixture
def path(tmp_path):
    simulate(counting(*SETTINGS), tmp_path / "scan.h5")
    return tmp_path / "scan.h5"


def test_every_channel_has_the_mask(path):
    mask = views_of(counting(*SETTINGS)).detector.mask
    with open_dataset(path) as dataset:
        for name in dataset.spectra.channels:
            stored = dataset.file[FIELD.format(name)]
            assert stored.dtype == np.uint32
            np.testing.assert_array_equal(stored[()], mask)
            np.testing.assert_array_equal(dataset.file[f"nxtomo_{name}/instrument/detector/pixel_mask"][()], mask)
        np.testing.assert_array_equal(dataset.mask, np.broadcast_to(mask != 0, dataset.mask.shape))
        assert dataset.dark[~dataset.mask].max() == 0
        assert dataset.dark[dataset.mask].max() > 0
    assert validate(path) == []
    bad = np.count_nonzero(mask)
    assert describe(path)["masked_pixels"] == bad
    assert f"mask       {bad} pixels do not measure" in describe_text(describe(path))


def test_a_mask_may_be_kept_back(tmp_path):
    simulate(counting(*SETTINGS, "effects.defects.masked=false"), tmp_path / "scan.h5")
    with open_dataset(tmp_path / "scan.h5") as dataset:
        assert not dataset.mask.any()
        assert FIELD.format(dataset.spectra.channels[0]) not in dataset.file
        assert (dataset.load()[..., 2] == 0).all()
    assert "mask " not in describe_text(describe(tmp_path / "scan.h5"))


def replaced(path, values):
    with edited_dataset(path) as file:
        name = FIELD.format("bin0")
        del file[name]
        file[name] = values
    return path


def test_high_bits_only_say_something(path):
    with open_dataset(replaced(path, np.full((40, 48), 1 << 31, np.uint32))) as dataset:
        assert not dataset.mask[0].any()
        assert dataset.mask[1].any()


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (np.zeros((40, 47), np.uint32), r"shape \(40, 47\), expected \(40, 48\)"),
        (np.zeros((40, 48)), "holds float64"),
        (np.full((40, 48), 2, np.uint32), "leaves no pixel that measures"),
    ],
)
def test_impossible_masks_are_refused(path, values, words):
    with pytest.raises(DatasetError, match=words):
        open_dataset(replaced(path, values))


def test_masked_pixels_do_not_tell_the_level_of_air(path):
    with open_dataset(path, air="0:5,0:48") as by_air, open_dataset(path) as by_flats:
        good = ~by_flats.mask
        np.testing.assert_allclose(by_air.flat[good].mean(), by_flats.flat[good].mean(), rtol=0.01)
        assert np.ptp(by_air.flat, axis=(1, 2)).max() == 0
    with open_dataset(path, air="0:5,2:3") as dataset, pytest.raises(InputError, match="no pixel of the region of air"):
        _ = dataset.flat


def test_signals_may_be_negative_but_counts_may_not(tmp_path):
    dark = integrating("geometry.views=1", "source.photons=1", "effects.electronics.sigma=1000", "darks=3")
    simulate(dark, tmp_path / "dark.h5")
    with open_dataset(tmp_path / "dark.h5") as dataset:
        assert dataset.load().min() < 0
        assert abs(dataset.dark.std() / (1000 / np.sqrt(3)) - 1) < 5 / np.sqrt(2 * dataset.dark.size)
    assert validate(tmp_path / "dark.h5") == []
