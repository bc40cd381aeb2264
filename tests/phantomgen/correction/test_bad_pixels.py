"""Bad pixels are found by flats and by changes between views, and good ones are left."""

import numpy as np
import pytest

from phantomgen.correction.bad_pixels import NOISY, UNDER, PixelStatistics, find_bad_pixels
from phantomgen.effects.defects import CLUSTER, DEAD, HOT, Defects

SHAPE = (40, 48)


def panel(seed: int = 0, views: int = 60) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Flat, and counts of views of an object with a sharp static edge, with 5 % gain."""
    random = np.random.default_rng(seed)
    gain = 1 + 0.05 * random.standard_normal(SHAPE)
    flat = random.poisson(1000 * gain * 20) / 20
    wave = 0.6 + 0.3 * np.sin(np.arange(SHAPE[1]) / 6 + np.arange(views)[:, None])
    through = np.repeat(wave[:, None], SHAPE[0], axis=1)
    through[:, :8] = 1.0
    return flat, random.poisson(1000 * gain * through).astype(float), np.zeros(SHAPE)


def found(flat, counts, dark):
    return find_bad_pixels(PixelStatistics(flat, dark, counts.mean(axis=0), counts.var(axis=0, ddof=1), len(counts)))


@pytest.mark.parametrize("seed", range(4))
def test_good_pixels_are_left(seed):
    assert not found(*panel(seed)).any()


def test_dead_stuck_weak_and_noisy_pixels_are_told_apart():
    flat, counts, dark = panel()
    flat[3, 4] = counts[:, 3, 4] = 0
    flat[5, 30] = counts[:, 5, 30] = 1000  # stuck at the level of the open beam: flats cannot tell
    flat[20, 20] *= 0.5
    flat[30, 10] *= 1.6
    counts[::2, 33, 33] = 6000
    mask = found(flat, counts, dark)
    assert mask[3, 4] == DEAD
    assert mask[5, 30] == HOT
    assert mask[20, 20] == UNDER
    assert mask[30, 10] == HOT
    assert mask[33, 33] == NOISY
    assert np.count_nonzero(mask) == 5


def test_a_hot_pixel_that_darks_show_is_found():
    flat, counts, dark = panel()
    dark[7, 7], flat[7, 7], counts[:, 7, 7] = 2000, 0, 0
    assert found(flat, counts, dark)[7, 7]


def test_lines_and_clusters_are_whole():
    flat, counts, dark = panel()
    true = Defects(dead=0.01, clusters=2, columns=(17,)).mask(3, *SHAPE) > 0
    flat[true], counts[:, true] = 0, 0
    mask = found(flat, counts, dark)
    assert ((mask > 0) == true).all()
    assert (mask[:, 17] & CLUSTER > 0).all()


def test_few_views_say_nothing_about_changes():
    flat, counts, dark = panel(views=4)
    counts[:, 5, 5] = counts[0, 5, 5]
    assert not found(flat, counts, dark).any()
