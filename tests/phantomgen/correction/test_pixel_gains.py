"""Gains of pixels from views: what flats do not show is found, and objects are left as they are."""

import numpy as np
import pytest

from phantomgen.correction.pixel_gains import LEAST, pixel_gains

RUNS, SHAPE = 12, (64, 72)


def transmissions(moving: bool = True) -> np.ndarray:
    """Mean transmission of a cylinder about the axis, with a second one that moves from run to run."""
    rows, columns = np.indices(SHAPE)
    images = []
    for run in range(RUNS):
        chord = 2 * np.sqrt(np.maximum(26.0**2 - (columns - 35.5) ** 2, 0))
        chord[(rows < 10) | (rows > 53)] = 0
        place = 35.5 + (15 * np.cos(2 * np.pi * run / RUNS) if moving else 0)
        chord += 2 * np.sqrt(np.maximum(6.0**2 - (columns - place) ** 2, 0))
        images.append(np.exp(-0.02 * chord))
    return np.stack(images)


def test_gains_of_single_pixels_are_found_away_from_edges():
    random = np.random.default_rng(0)
    gain = 1 + 0.01 * random.standard_normal(SHAPE)
    seen = transmissions() * gain * (1 + 5e-4 * random.standard_normal((RUNS, *SHAPE)))
    found = pixel_gains(seen, np.ones(SHAPE, bool))
    assert found.spread == pytest.approx(0.01, rel=0.25)
    left = gain / found.gain
    inside = np.s_[20:44, 20:52]
    assert left[inside].std() < 0.6 * gain[inside].std()  # the smooth part of the gains stays
    assert left.std() < gain.std()


@pytest.mark.parametrize("moving", [True, False])
def test_an_object_without_gains_is_left_as_it_is(moving):
    random = np.random.default_rng(1)
    seen = transmissions(moving) * (1 + 5e-4 * random.standard_normal((RUNS, *SHAPE)))
    found = pixel_gains(seen, np.ones(SHAPE, bool))
    assert found.spread < LEAST
    assert (found.gain == 1).all()


def test_edges_of_a_round_object_do_not_become_gains():
    random = np.random.default_rng(2)
    gain = 1 + 0.01 * random.standard_normal(SHAPE)
    found = pixel_gains(transmissions() * gain, np.ones(SHAPE, bool))
    edge = np.s_[20:44, 7:12]
    assert np.abs(np.log(found.gain[edge]).mean(axis=0)).max() < 0.005  # the edge bends log transmissions by 0.2 there


def test_columns_get_gains_from_rows_in_air():
    random = np.random.default_rng(3)
    gain = np.ones(SHAPE) * (1 + 0.01 * random.standard_normal(SHAPE[1]))
    pixels = 1 + 0.004 * random.standard_normal(SHAPE)
    object_free = np.ones((RUNS, *SHAPE))
    object_free[:, 20:44] = transmissions(False)[:, 20:44]
    found = pixel_gains(object_free * gain * pixels, np.ones(SHAPE, bool))
    left = (gain * pixels / found.gain)[50:]
    assert left.mean(axis=0).std() < 0.6 * gain[0].std()


def test_bad_pixels_and_few_runs_get_no_gain():
    measures = np.ones(SHAPE, bool)
    measures[30:33, 30:33] = False
    seen = transmissions() * (1 + 0.01 * np.random.default_rng(4).standard_normal(SHAPE))
    seen[:, ~measures] = 0
    assert (pixel_gains(seen, measures).gain[~measures] == 1).all()
    few = pixel_gains(seen[:3], measures)
    assert np.isinf(few.noise)
    assert (few.gain == 1).all()
