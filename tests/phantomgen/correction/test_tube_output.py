"""Tube output from parts of the panel in air: values within their uncertainty, and no value without air."""

import numpy as np
import pytest

from phantomgen.correction.tube_output import BlockSums, tube_output


def sums(drift: float, seed: int = 0, in_air: int = 12, views: int = 50) -> tuple[BlockSums, np.ndarray]:
    random = np.random.default_rng(seed)
    factors = 1 + drift * random.standard_normal(views)
    through = np.ones((views, 40))
    through[:, in_air:] = random.uniform(0.1, 0.95, (views, 40 - in_air))
    air = np.full((views, 40), 2e5)
    return BlockSums(random.poisson(air * factors[:, None] * through).astype(float), air), factors


@pytest.mark.parametrize("seed", range(3))
def test_factors_are_found_within_their_uncertainty(seed):
    blocks, factors = sums(0.02, seed)
    found = tube_output(blocks)
    assert found.is_known
    assert not found.is_steady
    assert found.blocks.tolist() == [True] * 12 + [False] * 28
    assert found.uncertainty.mean() == pytest.approx(1 / np.sqrt(12 * 2e5), rel=0.05)
    assert np.std((found.factors - factors) / found.uncertainty) == pytest.approx(1, abs=0.3)


def test_a_steady_tube_is_left_alone():
    assert tube_output(sums(0.0)[0]).is_steady


def test_without_air_nothing_is_known():
    assert not tube_output(sums(0.02, in_air=0)[0]).is_known


def test_a_block_that_an_object_crosses_in_one_view_is_no_air():
    blocks, factors = sums(0.02)
    blocks.counts[7, 3] *= 0.97
    found = tube_output(blocks)
    assert not found.blocks[3]
    assert np.abs(found.factors - factors).max() < 5 * found.uncertainty.max()


def test_blocks_without_pixels_that_measure_are_left_out():
    blocks, factors = sums(0.02)
    blocks.counts[:, 0] = blocks.air[:, 0] = 0
    assert tube_output(blocks).factors == pytest.approx(factors, abs=4e-3)
