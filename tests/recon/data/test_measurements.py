from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from support.gaussian_scenes import NAMES, SDD, SOD, circular, small_model, small_scan, spectral_model

from phantomgen.dataset.reader import Dataset
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from recon.data.measurements import matching_bin, read_measurements
from recon.gaussians.recipe import FAST
from recon.gaussians.reconstruct import _mean_information
from spectra.errors import GeometryError, InputError


@pytest.fixture(scope="module")
def scan():
    return small_scan(small_model(1, count=20), circular(12, 18, views=6), spectral_model(3), seed=2)


@pytest.mark.parametrize("views", [slice(1, 4), [0, 5], np.array([3])])
def test_some_views_are_those_views(scan, views):
    exposure = np.arange(24.0).reshape(6, 4)
    scan = replace(scan, exposure=exposure)
    some = scan[views]
    np.testing.assert_array_equal(some.counts, scan.counts[views])
    np.testing.assert_array_equal(some.exposure, exposure[views])
    assert some.geometry == scan.geometry[views]
    assert len(some) == len(some.geometry) == len(some.counts)


@pytest.mark.parametrize("factor", [2, 3, 6])
def test_binning_sums_counts_and_open_beam(scan, factor):
    binned = scan.binned(factor)
    assert binned.counts.shape == (6, 4, 12 // factor, 18 // factor)
    summed = scan.summed(factor)
    assert summed.counts.sum() == pytest.approx(scan.counts.sum(), rel=1e-6)
    assert summed.counts[1, 2, 0, 1] == scan.counts[1, 2, :factor, factor : 2 * factor].sum()
    assert (binned.counts < 1.01 * summed.counts).all()  # less what partial volume added
    assert binned.counts.sum() > 0.8 * summed.counts.sum()
    flat = replace(scan, counts=np.full_like(scan.counts, 500.0)).binned(factor)
    np.testing.assert_allclose(flat.counts, 500 * factor**2, rtol=1e-3)
    np.testing.assert_array_equal(binned.gains, factor**2)
    assert binned.geometry.panel.column_pitch == scan.geometry.panel.column_pitch * factor
    np.testing.assert_array_equal(binned.geometry.panel_center, scan.geometry.panel_center)


def test_pixels_cut_into_finer_ones_and_summed_are_those_pixels(scan):
    fine = scan.geometry.subdivided(3)
    assert fine.panel.rows == 3 * scan.geometry.panel.rows
    back = fine.binned(3)
    assert back.panel.columns == scan.geometry.panel.columns
    for name in ("source", "panel_center", "column_step", "row_step"):
        np.testing.assert_allclose(getattr(back, name), getattr(scan.geometry, name), rtol=1e-14)


def test_no_binning_is_the_scan_itself(scan):
    assert scan.binned(1) is scan


def test_a_panel_that_does_not_divide_is_refused(scan):
    with pytest.raises(GeometryError, match="12 x 18 pixels cannot be binned by 5"):
        scan.binned(5)


def test_channels_that_views_lack_are_interpolated_between_their_neighbours(scan):
    assert scan.completed() is scan
    logs = np.linspace(-3, 0, 6)[:, None, None, None]
    open_beam = scan.counts.max()
    turns = (np.arange(6)[:, None] % 2 == np.array([0, 0, 1, 1])).astype(float) * 2.0
    counts = (open_beam * np.exp(logs) * turns[:, :, None, None] * np.ones(scan.counts.shape)).astype(np.float32)
    found = replace(scan, counts=counts, exposure=turns).completed()
    assert (found.exposure > 0).all()
    taken = turns > 0
    np.testing.assert_array_equal(found.counts[taken], counts[taken])
    np.testing.assert_allclose(
        np.log(found.counts[1:5] / found.exposure[1:5, :, None, None] / open_beam),
        np.broadcast_to(logs[1:5], found.counts[1:5].shape), atol=1e-5,
    )  # fmt: skip
    np.testing.assert_allclose(found.counts[0, 2], found.counts[1, 2] / 2, rtol=1e-6)  # nothing before: the nearest


def test_rays_tell_their_information_where_the_views_that_are_asked_lack_channels(scan):
    """One view of eight is asked: where sources take turns, all of those may be of the same source."""
    turns = (np.arange(6)[:, None] % 2 == np.array([0, 0, 1, 1])).astype(float)
    counts = (scan.counts * turns[:, :, None, None]).astype(np.float32)
    found = _mean_information(replace(scan, counts=counts, exposure=turns), 1.0, FAST)
    np.testing.assert_allclose(found, _mean_information(scan, 1.0, FAST), rtol=0.3)


def test_compression_states_an_error_that_holds_for_the_rays_of_the_scan(scan):
    few, error = scan.compressed(1e-3)
    lengths = np.moveaxis(small_model(1, count=20).line_integrals(scan.geometry).numpy(), 1, -1).astype(float)
    whole = np.log(scan.transmission.expected(lengths))
    assert abs(np.log(few.transmission.expected(lengths)) - whole).max() < 2 * max(error, 1e-9)
    assert error < 1e-3
    assert len(few.transmission.weights) <= len(scan.transmission.weights)


@pytest.mark.parametrize(("size", "factor"), [(0.1, 1), (0.9, 1), (1.8, 2), (2.6, 2), (2.8, 3), (100, 6)])
def test_pixels_are_binned_until_they_match_a_size_at_the_isocentre(size, factor):
    geometry = circular(12, 18)
    assert pytest.approx(geometry.panel.column_pitch * SOD / SDD) == 0.9
    assert matching_bin(geometry, size) == factor


def fake_dataset(model, counts, flat, dark):
    """What `read_measurements` asks of a dataset."""
    basis = SimpleNamespace(names=NAMES[: len(model.columns)], signed=False)
    spectra = SimpleNamespace(
        basis=basis, transmission=lambda: model, quantum=np.ones(len(model)), profile=None, dead_time=None,
        events=lambda counts: counts,
    )  # fmt: skip
    geometry = Geometry.circular(60, 100, np.arange(3.0), Panel(4, 5, 1.0))
    return Mock(
        spec=Dataset, path=Path("scan.h5"), spectra=spectra, geometry=geometry, flat=flat, dark=dark,
        mask=np.zeros(flat.shape, bool), dark_variance=np.zeros(len(flat)), exposure=np.arange(12.0).reshape(3, 4),
        load=lambda views: counts[views], counts=counts, scatter=None,
    )  # fmt: skip


@pytest.mark.parametrize("bases", [None, 2])
def test_reading_takes_darks_off_and_compares_flats_with_the_model(bases):
    model, rng = spectral_model(3), np.random.default_rng(3)
    counts = rng.integers(0, 100, (3, 4, 4, 5))
    gain, dark = rng.uniform(0.5, 2, (4, 4, 5)), np.full((4, 4, 5), 7.0)
    gain[1, 2, 3] = 0.0
    dataset = fake_dataset(model, counts, gain * model.open_beam[:, None, None], dark)
    found = read_measurements(dataset, np.array([2, 0]), bases)
    np.testing.assert_allclose(found.gains, gain, rtol=1e-6)
    np.testing.assert_array_equal(found.counts, np.where(gain > 0, np.maximum(counts[[2, 0]] - 7, 0), 0))
    np.testing.assert_array_equal(found.exposure, dataset.exposure[[2, 0]])
    assert found.basis_names == NAMES[:bases]
    assert len(found.transmission.columns) == len(found.basis_names)
    assert found.counts.dtype == found.gains.dtype == np.float32


def test_more_bases_than_the_dataset_has_or_its_channels_allow_are_refused():
    blank = np.ones((2, 4, 5))
    dataset = fake_dataset(spectral_model(3, channels=2), np.ones((3, 2, 4, 5)), blank, 0 * blank)
    with pytest.raises(InputError, match=r"scan\.h5 has the bases photoelectric, compton, kedge: 4 were asked for"):
        read_measurements(dataset, np.arange(3), 4)
    with pytest.raises(InputError, match="2 channels cannot tell 3 bases apart"):
        read_measurements(dataset, np.arange(3))


def test_a_channel_that_is_blind_does_not_limit_the_range_of_the_compression(scan):
    gains, counts = scan.gains.copy(), scan.counts.copy()
    gains[0], counts[:, 0] = 0, 0
    blind, _ = replace(scan, gains=gains, counts=counts).compressed(1e-3)
    lengths = np.moveaxis(small_model(1, count=20).line_integrals(scan.geometry).numpy(), 1, -1).astype(float)
    whole = np.log(scan.transmission.expected(lengths))
    assert abs(np.log(blind.transmission.expected(lengths)) - whole).max() < 2e-3
