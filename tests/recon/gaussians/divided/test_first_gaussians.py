"""Where divided Gaussians and their prior are."""

from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np

from phantomgen.geometry.voxel_grid import Grid
from recon.data.measurements import Measurements
from recon.gaussians.initial.first_guess import Scan, part_with_gaussians
from recon.gaussians.recipe import FAST
from recon.gaussians.reconstruct import _prior_of


def test_the_prior_reaches_as_far_as_gaussians_are_placed():
    grid, names = Grid.cube(8, 16.0), ("photoelectric", "compton")
    geometry = SimpleNamespace(panel=SimpleNamespace(rows=8))
    measured = SimpleNamespace(basis_names=names, geometry=geometry)
    scan = Scan(measured, 0.0, SimpleNamespace(grid=grid), np.eye(2), 0)
    volumes = np.full((2, *grid.shape), 0.02, np.float32)
    part = part_with_gaussians(volumes, scan, FAST)
    prior = _prior_of(volumes, scan, Mock(spec=Measurements, exposure=np.ones((9, 1), np.float32)), FAST)
    assert prior.grid == part.grid
    air = FAST.surfaces.air
    assert part.grid.shape == tuple(n + 2 * air for n in grid.shape)
    assert prior.trust[0, 0, 0] == 1  # nothing attenuates in the air around, and the fit is held to that
    assert not prior.volumes[:, :air].any()
