"""Scores of the material maps of a comparison."""

import numpy as np
import pytest
from support.tiny_scans import make

from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.truth import read_truth
from recon.comparison.scoring.material_maps import score_maps
from recon.voxel.model import Voxels


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "tiny.h5"
    return make(path, "--set", "geometry.views=2", "--set", "geometry.test_views=1", voxels=32)


@pytest.mark.parametrize("bases", [2, 3])
def test_the_truth_has_the_maps_of_its_materials(scan, bases):
    truth = read_truth(scan)
    with open_dataset(scan) as dataset:
        found = score_maps(Voxels(truth.volumes[:bases], truth.grid, truth.basis_names[:bases]), dataset)
    assert set(found["dice"]) == {"soft_tissue", "bone", "contrast_high", "contrast_low"}
    assert min(found["dice"][name] for name in ("soft_tissue", "bone")) > 0.9
    assert bases == 2 or found["mean_dice"] > 0.9  # without their edge, contrast agents of few voxels are one
    assert found["rgb_views"]["psnr"] > 20


def test_a_volume_of_nothing_has_no_maps(scan):
    truth = read_truth(scan)
    with open_dataset(scan) as dataset:
        assert score_maps(Voxels(np.zeros_like(truth.volumes), truth.grid, truth.basis_names), dataset) == {}
        assert score_maps(Voxels(truth.volumes[:1], truth.grid, ("another",)), dataset) == {}
