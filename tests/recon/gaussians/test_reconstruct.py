"""The stages of a fit from a dataset to a result."""

import pytest
from support.tiny_scans import make

from phantomgen.dataset.reader import open_dataset
from recon.gaussians.recipe import FAST, with_residual_in_voxels
from recon.gaussians.reconstruct import reconstruct


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    return make(tmp_path_factory.mktemp("stages") / "scan.h5")


@pytest.mark.parametrize(("ended", "later"), [(True, ["mark"]), (False, ["judge", "residual", "mark"])])
def test_a_fit_that_is_ended_after_a_step_is_not_judged_and_gets_no_residual(scan, ended, later):
    stages = []
    with open_dataset(scan) as dataset:
        recipe = with_residual_in_voxels(FAST)
        result = reconstruct(dataset, recipe, on_stage=stages.append, on_step=lambda progress: ended)
    assert stages[stages.index("fit") + 1 :] == later
    assert (result.notes, result.told) == ((), ()) or not ended
