"""Where a fit starts, by orbit, and that it goes on from there."""

from unittest.mock import Mock

import numpy as np
import pytest
from support.gaussian_scenes import small_scan, spectral_model, tilted
from support.orbit_scenes import FILTERED, GRID, ITERATED, blobs, circle, relative_error

from phantomgen.dataset.reader import open_dataset
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.run import simulate
from recon.data.material_decomposition import decompose_views
from recon.gaussians.initial.initialize import initialize
from recon.gaussians.optimize import fit
from recon.gaussians.recipe import Recipe, Stage
from recon.runs.methods import method_named
from recon.runs.run import run
from recon.runs.run_gaussians import GaussianRun
from recon.runs.run_voxels import VoxelRun
from recon.voxel.filtered.fdk import fdk
from recon.voxel.initial_volumes import initial_volumes, starting_method
from spectra.errors import GeometryError

SMALL = ["panel={rows: 8, columns: 8, pitch: 25.6}", "volume.voxels=8", "flats=2"]


@pytest.mark.parametrize("name", FILTERED)
def test_circles_start_from_filtered_back_projection(name):
    assert starting_method(FILTERED[name], GRID).name == "fdk"


@pytest.mark.parametrize("geometry", [*ITERATED.values(), tilted(views=3)], ids=[*ITERATED, "free"])
def test_all_else_starts_from_sart(geometry):
    assert starting_method(geometry, GRID).name == "sart"


@pytest.mark.parametrize("views", [[0], [3, 3, 3]])
def test_what_shows_no_depth_is_refused(views):
    with pytest.raises(GeometryError, match=r"have the same direction within 1\.1 degrees"):
        starting_method(circle()[views], GRID)


def test_volumes_of_a_full_circle_are_those_of_fdk_bit_by_bit():
    geometry, rng = circle(12), np.random.default_rng(1)
    images, nothing = rng.normal(size=(12, 2, 40, 48)).astype(np.float32), np.zeros((40, 48), bool)
    volumes = initial_volumes(images, nothing, geometry, GRID, starting_method(geometry, GRID))
    np.testing.assert_array_equal(volumes, fdk(images, geometry, GRID))


@pytest.mark.parametrize("name", ["half-fan", "short scan", "half a turn, parallel", *ITERATED])
def test_a_fit_gets_better_than_its_start_and_predicts_what_it_measured(name):
    """Noisy counts of blobs: as likely as they should be, and volumes nearer to the truth than those of the start."""
    geometry, truth = (FILTERED | ITERATED)[name], blobs()
    measured = small_scan(truth, geometry[:: max(len(geometry) // 24, 1)], spectral_model(2, 3), seed=1)
    lengths, fisher = decompose_views(measured, 0.01)
    method = starting_method(geometry, GRID)
    volumes = initial_volumes(lengths, measured.blind_pixels, measured.geometry, GRID, method)
    recipe = Recipe(stages=(Stage(1.0, 10.0),), centre_rate=0.06, shape_rate=0.015)  # the start is far off
    deviances = []
    start = initialize(volumes, GRID, fisher, recipe.spacing, truth.basis_names, 0)
    found = fit(start, measured, 1.0, recipe, lambda progress: deviances.append(progress.deviance))
    expected = truth.volume(GRID)
    assert relative_error(found.volume(GRID), expected) < 0.8 * relative_error(volumes, expected)
    assert np.mean(deviances[-8:]) < 1.2  # 1 is what noise alone leaves


def test_a_scan_without_depth_is_refused_before_any_work(tmp_path, monkeypatch):
    line = ["geometry={type: circular, sod: 500, sdd: 800, views: 4, arc: 0.5, test_views: 0}"]
    simulate(load_scene("kedge-small", [*SMALL, *line]), tmp_path / "a.h5")
    with open_dataset(tmp_path / "a.h5") as dataset:
        monkeypatch.setattr(type(dataset), "load", lambda *_: pytest.fail("read counts"))
        for method in (GaussianRun(Recipe()), VoxelRun(method_named("sart"))):
            with pytest.raises(GeometryError, match="a volume needs views from several sides"):
                run(dataset, tmp_path, method, False, Mock())
