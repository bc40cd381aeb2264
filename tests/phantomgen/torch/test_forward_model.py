"""The forward model of a dataset: the counts of the simulator, and of every effect that it knows."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from support.tiny_scans import make

import phantomgen
import phantomgen.torch as pt
from spectra.detector.dead_time import DeadTime


@pytest.fixture(scope="module")
def flooded(tmp_path_factory):
    """A scan without noise, of a tube with a heel effect and a bow-tie filter, and of an object that fills voxels."""
    path = tmp_path_factory.mktemp("flooded") / "scan.h5"
    return make(path, "--no-noise", "--views", "4", "--test-views", "1", rows=12, columns=16, voxels=32)


def test_air_has_the_counts_of_the_flats(flooded):
    with phantomgen.open(flooded) as dataset:
        model = pt.ForwardModel.of(dataset)
        air = torch.zeros(3, *dataset.grid.shape)
        found = model(air)
        expected = dataset.flat * dataset.exposure[:, :, None, None] + dataset.dark
        assert found.shape == dataset.counts.shape
        np.testing.assert_allclose(found, expected, rtol=1e-5)
        assert model.measures().all()


def test_true_volumes_have_the_counts_of_the_scan_but_for_their_voxels(flooded):
    truth = phantomgen.read_truth(flooded)
    with phantomgen.open(flooded) as dataset:
        model = pt.ForwardModel.of(dataset)
        measured, open_beam = dataset.load(), dataset.flat * dataset.exposure[:, :, None, None]
        found = model(torch.from_numpy(truth.volumes)).numpy()
    error = np.abs(np.log(found / measured)).mean() / np.abs(np.log(open_beam / measured)).mean()
    assert error < 0.03  # measured 0.016


def test_views_are_those_asked_for_and_batches_are_several_volumes(scan_paths):
    with phantomgen.open(scan_paths[0]) as dataset:
        model = pt.ForwardModel.of(dataset)
    volume = torch.rand(2, 3, *model.grid.shape, generator=torch.Generator().manual_seed(0)) * 0.01
    found = model(volume, [1, 3])
    assert found.shape == (2, 2, 4, 12, 16)
    torch.testing.assert_close(found[1], model(volume[1])[[1, 3]])


@pytest.mark.parametrize("kind", ["nonparalyzable", "paralyzable"])
def test_dead_time_is_that_of_the_detector(scan_paths, kind):
    with phantomgen.open(scan_paths[0]) as dataset:
        plain = pt.ForwardModel.of(dataset)
    dead_time = DeadTime(30.0, 1.0, kind)
    model = replace(plain, dead_time=dead_time)
    volume = torch.zeros(3, *model.grid.shape, dtype=torch.float64)
    events = (plain(volume) - plain.dark).numpy()
    assert dead_time.per_count * events.sum(axis=1).max() > 0.1  # enough to matter
    np.testing.assert_allclose(model(volume) - model.dark, dead_time.recorded(events), rtol=1e-12)


def test_a_beam_profile_is_in_front_of_the_object(tmp_path):
    scene = ["--set", "source.bowtie={composition: Al, density: 2.7, angles: [0, 8], thickness: [0, 10]}"]
    path = make(tmp_path / "bowtie.h5", "--no-noise", "--views", "2", "--test-views", "1", *scene, rows=12, columns=16)
    with phantomgen.open(path) as dataset:
        model = pt.ForwardModel.of(dataset)
        assert model.profile is not None
        assert model.profile.abs().max() > 0.1
        np.testing.assert_allclose(model.gains, 1, rtol=1e-3)  # the profile explains the flats
        lengths = 0.5 * np.ones((3, 12, 16))
        whole = np.concatenate([lengths, dataset.spectra.profile.lengths])
        expected = dataset.spectra.transmission().expected(np.moveaxis(whole, 0, -1))
        found = model.from_line_integrals(torch.from_numpy(lengths)[:, None], [0])[0]
        factor = (model.gains * model.exposure[0, :, None, None]).numpy()
        np.testing.assert_allclose(found, np.moveaxis(expected, -1, 0) * factor + dataset.dark, rtol=1e-9)
