"""Readings that end at the largest one of a channel: found in the counts, and lower bounds from then on."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.tiny_scans import make

from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.truth import read_truth
from phantomgen.degradation.run import degrade_file
from phantomgen.degradation.settings import Degradation
from recon.data.incomplete_counts import LargestReadings, saturation_notes
from recon.data.measurements import read_measurements
from recon.voxel.iterative.one_step import OneStep


def limits(images, open_beam, used=None):
    largest = LargestReadings(np.ones(images.shape[1:], bool) if used is None else used)
    for image in images:
        largest.add(image, open_beam)
    return largest.limits()


@settings(max_examples=60, deadline=None)
@given(mean=st.floats(-6, 14).map(np.exp), seed=st.integers(0, 2**31))
def test_photon_noise_alone_does_not_saturate(mean, seed):
    air = np.full((1, 40, 50), mean)
    thickness = np.random.default_rng(seed).uniform(0, 1, (1, 40, 50)) > 0.5
    images = np.random.default_rng(seed).poisson(np.where(thickness, 0.3 * mean, mean), (12, 1, 40, 50)).astype(float)
    assert np.isinf(limits(images, air)).all()


@pytest.mark.parametrize("part", [1.0, 0.9, 0.6])
def test_readings_that_end_are_found(part):
    air = np.random.default_rng(1).poisson(5000.0, (2, 40, 50)).astype(float)  # as flats measure it
    images = np.random.default_rng(0).poisson(5000 * np.linspace(0.2, 1, 50), (12, 2, 40, 50)).astype(float)
    images[:, 1] = np.minimum(images[:, 1], part * 5000)
    found = limits(images, air)
    assert np.isinf(found[0])
    assert found[1] == part * 5000


def test_the_open_beam_of_a_scan_without_noise_is_no_end():
    air = np.random.default_rng(0).uniform(900, 1100, (1, 40, 50))
    even = np.full_like(air, 1000.0)
    for beam in (air, even):
        assert np.isinf(limits(np.repeat(beam[None], 12, axis=0), beam)).all()


def test_pixels_that_are_left_out_do_not_count():
    air = np.full((1, 40, 50), 5000.0)
    images = np.random.default_rng(0).poisson(air, (12, 1, 40, 50)).astype(float)
    images[..., :20, :] = 65535
    used = np.ones(air.shape, bool)
    used[:, :20] = False
    assert limits(images, air)[0] == 65535
    assert np.isinf(limits(images, air, used)).all()


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    """A scan, and the same with readings that end at 0.7 open beams."""
    folder = tmp_path_factory.mktemp("saturated")
    whole = make(folder / "whole.h5", voxels=32, rows=64, columns=64)
    degrade_file(whole, folder / "ends.h5", Degradation(saturate=0.7), overwrite=True)
    return whole, folder / "ends.h5"


def test_saturated_counts_are_those_of_the_open_beam_with_lower_bounds(scans):
    whole, ends = scans
    with open_dataset(whole) as dataset:
        before = read_measurements(dataset, dataset.splits["train"])
        assert before.statistical_weights is None
        assert saturation_notes(dataset.spectra.channels, before.bounded) == ()
    with open_dataset(ends) as dataset:
        after = read_measurements(dataset, dataset.splits["train"])
        note = saturation_notes(dataset.spectra.channels, after.bounded)
    bound = after.statistical_weights < 0
    air = after.gains * after.open_beam * after.exposure[:, :, None, None]
    np.testing.assert_allclose(after.counts[bound], air[bound], rtol=1e-5)
    readings = -after.statistical_weights[bound] * after.counts[bound]
    assert (readings <= before.counts[bound] * (1 + 1e-5)).all()
    np.testing.assert_array_equal(after.counts[~bound], before.counts[~bound])
    np.testing.assert_allclose(after.bounded, bound.mean(axis=(0, 2, 3)))
    assert "Pixels saturate: " in note[0]


def test_blocks_of_pixels_keep_the_least_that_arrived(scans):
    with open_dataset(scans[1]) as dataset:
        measured = read_measurements(dataset, dataset.splits["train"][:3])
    coarse = measured.summed(2)
    weights, counts = measured.statistical_weights, measured.counts
    least = np.where(weights < 0, -weights * counts, counts).astype(float)
    blocks = least.reshape(*least.shape[:2], least.shape[2] // 2, 2, -1, 2).sum(axis=(3, 5))
    bound = coarse.statistical_weights < 0
    assert bound.any()
    np.testing.assert_allclose((-coarse.statistical_weights * coarse.counts)[bound], blocks[bound], rtol=1e-5)
    weighted = coarse.weighted(0.02).statistical_weights
    np.testing.assert_array_equal(weighted[bound], coarse.statistical_weights[bound])
    assert (weighted[~bound] >= 0).all()
    apart = np.ones((len(coarse), 1, 1), bool)
    assert not replace(coarse, unseen_blocks=apart).weighted(0.02).statistical_weights.any()


def test_a_saturated_scan_is_reconstructed_almost_as_a_whole_one(scans):
    errors = []
    for path in scans:
        with open_dataset(path) as dataset:
            measured = read_measurements(dataset, dataset.splits["train"])
            found, truth = OneStep().reconstruct_counts(measured, dataset.grid), read_truth(path)
            assert truth is not None
            errors.append([np.sqrt(np.mean((a - b) ** 2)) for a, b in zip(found, truth.volumes, strict=True)])
    assert (np.array(errors[1]) < 1.5 * np.array(errors[0])).all()
