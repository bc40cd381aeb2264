"""Standard deviations over volumes, against NumPy and against noise of known correlation."""

import numpy as np
import pytest

from phantomgen.geometry.voxel_grid import Grid
from recon.runs.write_run import write_volumes
from recon.uncertainty.spread import Replicates
from spectra.errors import DatasetError

GRID = Grid.cube(12, 24.0)
NAMES = ("photoelectric", "compton")


def written(folder, volumes, grid=GRID):
    paths = [folder / f"{k}.h5" for k in range(len(volumes))]
    for path, values in zip(paths, volumes, strict=True):
        write_volumes(path, values.astype(np.float32), NAMES, grid, {})
    return paths


@pytest.fixture(scope="module")
def volumes():
    return 0.02 + np.random.default_rng(1).normal(0, 1e-3, (6, 2, 12, 12, 12))


@pytest.fixture
def replicates(volumes, tmp_path):
    return Replicates.read(written(tmp_path, volumes))


def test_mean_and_variance_are_those_of_numpy_averaged_over_neighbours(replicates, volumes):
    found, variance = replicates.spread(), volumes.var(axis=0, ddof=1)
    assert found.mean == pytest.approx(volumes.mean(axis=0), rel=1e-5)
    middle = variance[:, 3:6, 4:7, 5:8].mean(axis=(1, 2, 3))
    assert found.deviation[:, 4, 5, 6] == pytest.approx(np.sqrt(middle), rel=1e-4)
    assert found.deviation.mean() == pytest.approx(1e-3, rel=0.02)


def test_quantities_are_computed_before_the_spread(replicates, volumes):
    found = replicates.spread(lambda v: v[0] ** 2)
    expected = np.sqrt((volumes[:, 0] ** 2).var(axis=0, ddof=1)[3:6, 3:6, 3:6].mean())
    assert found.deviation[4, 4, 4] == pytest.approx(expected, rel=1e-3)


def test_the_mean_of_a_region_has_the_deviation_of_noise_that_all_its_voxels_share(tmp_path):
    shared = np.random.default_rng(2).normal(0, 1e-3, 40)
    volumes = np.broadcast_to(0.02 + shared[:, None, None, None, None], (40, 2, 12, 12, 12))
    inside = np.zeros(GRID.shape, bool)
    inside[2:5, 2:5, 2:5] = True
    found = Replicates.read(written(tmp_path, volumes)).region(inside)
    assert found.deviation == pytest.approx(np.full(2, shared.std(ddof=1)), rel=1e-4)


def test_the_certainty_is_that_of_chi_square(replicates):
    assert replicates.certainty == pytest.approx(1 / np.sqrt(10))
    draws = np.random.default_rng(3).normal(0, 1, (20_000, 6)).std(axis=1, ddof=1)
    assert draws.std() == pytest.approx(replicates.certainty, rel=0.05)


def test_one_replicate_or_replicates_of_other_grids_are_refused(volumes, tmp_path):
    paths = written(tmp_path, volumes[:2])
    with pytest.raises(DatasetError, match="two replicates at least, got 1"):
        Replicates.read(paths[:1])
    write_volumes(paths[1], volumes[1].astype(np.float32), NAMES, Grid.cube(12, 25.0), {})
    with pytest.raises(DatasetError, match=r"1\.h5 has another grid or other bases than .*0\.h5"):
        Replicates.read(paths).spread()
