"""Counts of replicates: mean and variance in air against formulas, and the same numbers in any order."""

import numpy as np
import pytest

from phantomgen.dataset.file import FLAT
from phantomgen.dataset.reader import open_dataset
from recon.uncertainty.replicate import Replicate
from recon.voxel.model import Voxels
from tests.support.tiny_scans import make

COUNT = 60  # replicates; with some 1000 pixels, means and variances over all are known to better than 1 %
SCANS = {
    "counts": (),
    "signals": (
        "detector={type: energy_integrating, composition: CsI}",
        "effects.electronics={sigma: 3000, offset: 9000}",
        "darks=40",
        "basis=[{type: material, material: iron}]",
        "materials={iron: {composition: Fe}}",
        "objects=[{type: sphere, radius: 2, material: iron}]",
    ),
    "dead time": ("detector.dead_time={tau_ns: 100, exposure_ms: 10}",),
}


@pytest.fixture(scope="module", params=SCANS)
def dataset(request, tmp_path_factory):
    options = [item for value in (*SCANS[request.param], "geometry.views=6") for item in ("--set", value)]
    path = make(tmp_path_factory.mktemp("scan") / "scan.h5", *options)
    with open_dataset(path) as opened:
        yield opened


def replicate(dataset, density=0.0, seed=0, number=0):
    names, grid = dataset.spectra.basis.names, dataset.grid
    volumes = np.zeros((len(names), *grid.shape), np.float32)
    volumes[0, 4:-4, 4:-4, 4:-4] = density
    return Replicate.of(dataset, Voxels(volumes, grid, names), seed, number)


def test_counts_of_air_have_the_mean_of_the_flats_and_the_variance_of_their_noise(dataset):
    views = np.array([replicate(dataset, number=k).load([0])[0] for k in range(COUNT)], np.float64)
    flat, unit = dataset.flat * dataset.exposure[0][:, None, None], dataset.spectra.quantum
    variance = unit * flat.mean(axis=(1, 2)) + dataset.dark_variance
    dead_time = dataset.spectra.dead_time
    if dead_time is not None:
        variance *= dead_time.fano(dead_time.corrected(flat).sum(axis=0)).mean()
    assert views.mean(axis=(0, 2, 3)) == pytest.approx((flat + dataset.dark).mean(axis=(1, 2)), rel=1e-3)
    assert views.var(axis=0, ddof=1).mean(axis=(1, 2)) == pytest.approx(variance, rel=0.05)


def test_an_object_attenuates(dataset):
    air, behind = (replicate(dataset, density).load([0])[0] - dataset.dark for density in (0.0, 0.005))
    middle = np.s_[14:18, 14:18]
    assert (behind.sum(axis=0)[middle] < 0.97 * air.sum(axis=0)[middle]).all()
    corner, same = air[:, 0, 0], np.isclose(behind[:, 0, 0], air[:, 0, 0])
    assert same.mean() >= 0.5  # the same random numbers, but where means that differ by rounding reject a draw
    assert (np.abs(behind[:, 0, 0] - corner) < 6 * np.sqrt(2 * corner)).all()


def test_the_same_numbers_in_any_order_and_others_for_another_seed_or_number(dataset):
    both, second = replicate(dataset).load([0, 2]), replicate(dataset).load([2])
    assert np.array_equal(both[1], second[0])
    assert not np.array_equal(both[0], both[1])
    assert not np.array_equal(second, replicate(dataset, seed=1).load([2]))
    assert not np.array_equal(second, replicate(dataset, number=1).load([2]))


def test_flats_have_noise_of_their_own(dataset):
    flats = np.array([replicate(dataset, number=k).flat for k in range(COUNT)])
    frames = len(dataset.file[FLAT])
    expected = dataset.spectra.quantum * dataset.flat.mean(axis=(1, 2)) / frames
    assert flats.var(axis=0, ddof=1).mean(axis=(1, 2)) == pytest.approx(expected, rel=0.05)
    assert flats.mean(axis=(0, 2, 3)) == pytest.approx(dataset.flat.mean(axis=(1, 2)), rel=1e-3)


def test_all_else_is_that_of_the_file_also_in_another_basis(dataset):
    made = replicate(dataset)
    again = made.with_training_views(2)
    assert (again.seed, again.number, len(again.splits["train"])) == (0, 0, 2)
    assert np.array_equal(again.load([1]), made.load([1]))
    assert np.array_equal(made.mask, dataset.mask)
    assert np.array_equal(again.flat, made.flat)
