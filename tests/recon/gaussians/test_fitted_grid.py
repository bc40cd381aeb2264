"""What a fit of a truncated scan takes: the margin that it fits is counted before it is fitted."""

import pytest
from click.testing import CliRunner
from support.tiny_scans import make

from phantomgen.dataset.reader import open_dataset
from recon.cli.main import main
from recon.gaussians.fitted_grid import fitted_grid, read_with_coverage
from recon.gaussians.recipe import FAST, Recipe, Stage
from recon.runs.expected_cost import expected_cost
from recon.runs.memory_plan import GIB, plan_memory

SHORT = Recipe(stages=(Stage(1.0, 1.0),), voxel_passes=2, approximation=5)
VIEWS = ("--views", "20", "--test-views", "1")
NARROW = ("--set", "panel={rows: 32, columns: 16, pitch: 6.4}")


@pytest.fixture(scope="module")
def truncated(tmp_path_factory):
    return make(tmp_path_factory.mktemp("scans") / "cut.h5", *VIEWS, *NARROW, "--set", "volume={voxels: 8, size: 51.2}")


def least(dataset, grid):
    """GiB of a fit whose counts are on disk."""
    limit = plan_memory(dataset, FAST, 3, None, grid=grid).peak
    parts = plan_memory(dataset, FAST, 3, limit, grid=grid).parts
    return sum(size for name, size in parts.items() if name not in ("counts", "line integrals"))


def test_the_grid_is_known_before_the_fit(truncated, tmp_path):
    with open_dataset(truncated) as dataset:
        found = fitted_grid(dataset, FAST, 3, tmp_path)
        assert found == read_with_coverage(dataset, FAST, 3)[2].grid
        assert min(found.shape) > max(dataset.grid.shape)
    assert not list(tmp_path.iterdir())


def test_a_scan_of_the_whole_object_is_fitted_on_the_grid_asked_for(tmp_path):
    with open_dataset(make(tmp_path / "whole.h5", *VIEWS)) as dataset:
        assert fitted_grid(dataset, FAST, 3, tmp_path) == dataset.grid


def test_an_expected_cost_counts_the_margin(truncated):
    with open_dataset(truncated) as dataset:
        grid = read_with_coverage(dataset, SHORT, 3)[2].grid
        found = expected_cost(dataset, SHORT, 3, None)
    voxels = grid.shape[0] * grid.shape[1] * grid.shape[2]
    assert found.voxels == grid.shape
    assert found.memory.parts["volumes"] * GIB == pytest.approx(4 * voxels * 14 * 3)
    assert f"{' x '.join(map(str, grid.shape))} voxels" in str(found)


def test_a_bound_that_the_margin_exceeds_is_refused_before_the_fit(truncated, tmp_path):
    with open_dataset(truncated) as dataset:
        limits = [least(dataset, grid) for grid in (dataset.grid, fitted_grid(dataset, FAST, 3, tmp_path))]
    assert limits[0] < limits[1]
    options = ["--bases", "3", "-q", "-o", str(tmp_path / "run"), "--memory", str(sum(limits) / 2)]
    result = CliRunner().invoke(main, ["fit", str(truncated), *options])
    assert result.exit_code == 1
    assert "a margin around the truncated object included, needs at least" in result.stderr
    assert not list(tmp_path.iterdir())
