"""Scans of one slice: a panel of one row, whose tube voltage switches from view to view."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import phantomgen
from phantomgen.dataset.truth import read_truth
from recon.data.measurements import read_measurements
from recon.evaluation.scoring import psnr_of_bases
from recon.gaussians.initial.first_guess import OccupiedPart, in_air
from recon.gaussians.recipe import FAST
from recon.gaussians.reconstruct import reconstruct
from recon.voxel.iterative.one_step import OneStep
from recon.voxel.model import Voxels

SCENE = Path(__file__).parents[3] / "examples" / "switched_slice.yaml"
SMALL = ["volume.voxels=32", "panel.columns=64", "panel.pitch=5.72", "geometry.test_views=0"]


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    path = tmp_path_factory.mktemp("flat") / "flat.h5"
    with phantomgen.make(phantomgen.load(SCENE, SMALL), out=path) as dataset:
        yield dataset


def test_a_scene_may_ask_for_some_slices(scan):
    assert scan.grid.shape == (1, 32, 32)
    assert scan.grid.spacing == (5.625, 5.625, 5.625)
    assert scan.grid.origin[0] == 0.0
    assert scan.grid.origin[1:] == (-87.1875, -87.1875)
    assert read_truth(scan.path).volumes.shape == (2, 1, 32, 32)


def test_many_switched_views_do_not_diverge(scan):
    # With subsets for 256 views of a kind, where there are 128, the photoelectric basis ended at -13 dB.
    measured = read_measurements(scan, scan.splits["train"])
    volumes = OneStep().reconstruct_counts(measured, scan.grid)
    found = psnr_of_bases(read_truth(scan.path), Voxels(volumes, scan.grid, measured.basis_names))
    assert found["psnr_photoelectric"] > 19
    assert found["psnr_compton"] > 30


def test_no_pass_over_two_broad_spectra_raises_the_deviance(scan):
    # Without the residual curvature of the expected counts, passes on coarse voxels ended at 1 to 5000 times the first.
    measured = read_measurements(scan, scan.splits["train"])
    passes = []
    OneStep().reconstruct_counts(measured, scan.grid, lambda it: passes.append((it.grid, it.residual)))
    for (grid, before), (same, after) in pairwise(passes):
        assert after < 1.05 * before or grid != same


def test_gaussians_of_one_row_are_better_than_the_voxels_they_began_with(scan):
    # With air above and below the slice, its faces took most Gaussians, and Compton ended 8 dB below the voxels.
    result = reconstruct(scan, FAST)
    truth = read_truth(scan.path)
    models = (Voxels(volumes, scan.grid, truth.basis_names) for volumes in (result.initial_volumes, result.volumes))
    start, end = (psnr_of_bases(truth, model) for model in models)
    assert all(end[name] > start[name] for name in start)
    assert len(result.gaussians) < 1000


@pytest.mark.parametrize(("alike", "above"), [(True, 2.0), (False, 0.0)])
def test_a_slice_goes_on_above_and_below_or_has_air_there(scan, alike, above):
    part = in_air(OccupiedPart(np.full((1, *scan.grid.shape), 2.0, np.float32), scan.grid), 3, alike)
    assert part.grid.shape == part.volumes.shape[1:] == (7, 38, 38)
    assert part.grid.origin[0] == -3 * scan.grid.spacing[0]
    assert (part.volumes[0, 0, 3:-3, 3:-3] == above).all()
    assert not part.volumes[0, :, 0].any()


def test_several_slices_always_have_air_above_and_below(scan):
    grid = phantomgen.Grid((2, 3, 3), scan.grid.spacing, (0.0, 0.0, 0.0))
    assert not in_air(OccupiedPart(np.ones((1, 2, 3, 3), np.float32), grid), 1, alike=True).volumes[0, 0].any()
