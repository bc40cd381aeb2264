"""Reconstructions behind estimates of scatter, along a curve of materials for one channel."""

import pytest
from support.one_channel_scans import WATER, one_channel_scan

from recon.kedge.basis_names import OnCurve
from recon.scatter.voxel_fit import VoxelFit
from recon.voxel.method import no_callback


@pytest.fixture(scope="module")
def fit(tmp_path_factory):
    path = tmp_path_factory.mktemp("one") / "one.h5"
    small = {"panel": {"rows": 24, "columns": 36, "pitch": 5}, "volume": {"voxels": 20, "size": 80}}
    with one_channel_scan(path, WATER, **small) as dataset:
        yield VoxelFit.of(dataset, OnCurve(), no_callback)


def test_a_curve_has_all_its_bases_from_one_channel(fit):
    assert fit.count == 2
    volumes, grid = fit.volumes(fit.dataset, 20)
    assert volumes.shape == (2, *grid.shape)


def test_wrong_volumes_explain_the_rays_worse(fit):
    volumes, grid = fit.volumes(fit.dataset, 20)
    assert fit.deviance_per_ray(volumes, grid) < 0.2 * fit.deviance_per_ray(volumes * 1.05, grid)
