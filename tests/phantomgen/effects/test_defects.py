"""Defects: which pixels, what they read, and the mask."""

import numpy as np
import pytest
from support.detector_scenes import counting, frames, integrating, views_of

from phantomgen.effects import Defects
from phantomgen.effects.defects import CLUSTER, DEAD, HOT
from phantomgen.effects.random_streams import Stream
from spectra.errors import InputError, SceneError

SOME = "effects.defects={dead: 0.02, hot: 0.01, level: 1.5, rows: [3], clusters: 1, radius: 2}"


def test_bits_are_those_of_nexus():
    assert (DEAD, HOT, CLUSTER) == (2, 8, 64)


def test_parts_of_the_panel_are_exact_and_apart():
    mask = Defects(dead=0.03, hot=0.02).mask(1, 100, 100)
    assert np.count_nonzero(mask == DEAD) == 300
    assert np.count_nonzero(mask == HOT) == 200
    assert set(np.unique(mask)) == {0, DEAD, HOT}


def test_lines_and_discs_are_dead_and_clusters():
    mask = Defects(rows=(0, 7), columns=(5,)).mask(1, 20, 30)
    wanted = np.zeros((20, 30), bool)
    wanted[[0, 7]], wanted[:, 5] = True, True
    np.testing.assert_array_equal(mask, np.where(wanted, DEAD | CLUSTER, 0))
    disc = Defects(clusters=1, radius=5.0).mask(4, 400, 400) != 0
    assert disc.sum() == pytest.approx(np.pi * 25, rel=0.15)


def test_the_pattern_belongs_to_the_seed():
    defects = Defects(dead=0.1)
    np.testing.assert_array_equal(defects.mask(1, 30, 30), defects.mask(1, 30, 30))
    assert (defects.mask(1, 30, 30) != defects.mask(2, 30, 30)).any()


@pytest.mark.parametrize("make", [counting, integrating])
@pytest.mark.parametrize("noise", [True, False])
def test_dead_pixels_read_zero_and_hot_ones_their_level_everywhere(make, noise):
    views, good = views_of(make(SOME)), views_of(make())
    mask, level = views.detector.mask, 1.5 * views.exposure.transmission.open_beam
    for stream in (Stream.PROJECTION, Stream.FLAT, Stream.DARK):
        read, right = (frames(v, stream, 2, noise) for v in (views, good))
        assert (read[..., (mask & DEAD) != 0] == 0).all()
        hot = read[..., (mask & HOT) != 0]
        np.testing.assert_allclose(hot, np.broadcast_to(level[:, None], hot.shape), rtol=1e-3)
        np.testing.assert_array_equal(read[..., mask == 0], right[..., mask == 0])


def test_counts_stay_integers():
    views = views_of(counting(SOME))
    signals = views.registered(views.expected(0), 0)
    assert {image.dtype for image in views.read(signals, 0)} == {np.dtype(np.int32)}


@pytest.mark.parametrize("bad", [{"dead": 0.6}, {"hot": -0.1}, {"level": np.inf}, {"clusters": -1}])
def test_impossible_defects_are_refused(bad):
    with pytest.raises(InputError):
        Defects(**bad)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("{rows: [40]}", r"effects\.defects - there is no row 40 on a panel of 40 rows, counted from 0"),
        ("{clusters: 1, radius: 99}", r"effects\.defects - no pixel of 40 x 48 is left that measures"),
        ("{dead: 0.9}", r"effects\.defects\.dead"),
    ],
)
def test_a_scene_names_what_is_wrong(given, words):
    with pytest.raises(SceneError, match=words):
        counting(f"effects.defects={given}")
