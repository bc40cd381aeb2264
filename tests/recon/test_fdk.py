import numpy as np
import pytest
import torch
from gaussian_scenes import NAMES, circular, tilted
from tolerances import TOLERANCES

from phantomgen.geometry import Geometry
from phantomgen.grid import Grid
from phantomgen.panel import Panel
from recon.baselines.fdk import fdk
from recon.gaussians import Gaussians
from spectra.errors import GeometryError

GRID = Grid.cube(24, 24.0)


def blobs(centres, sigma=5.0):
    """Upright Gaussians of two bases, the second twice the first [1/mm]."""
    n = len(centres)
    turns = torch.tensor([[1.0, 0, 0, 0]]).repeat(n, 1)
    values = torch.tensor([[0.01, 0.02]]).repeat(n, 1)
    return Gaussians(torch.tensor(centres), torch.full((n, 3), float(np.log(sigma))), turns, values, NAMES[:2])


@pytest.mark.parametrize(("hann", "views"), [(np.inf, 120), (1.0, 120)])
def test_gaussians_come_back_with_their_absolute_scale(hann, views):
    geometry = Geometry.circular(500, 800, 2 * np.pi / views * np.arange(views), Panel(40, 48, 1.6))
    truth = blobs([[0.0, 0.0, 0.0], [6.0, -3.0, 0.0]], 4.0)
    volume = fdk(truth.line_integrals(geometry).numpy(), geometry, GRID, hann)
    expected = truth.volume(GRID)
    for found, right in zip(volume, expected, strict=True):
        middle = np.s_[8:16]  # near the plane of the orbit, where the method is exact
        scale = (found[middle] * right[middle]).sum() / (right[middle] ** 2).sum()
        assert scale == pytest.approx(1, abs=TOLERANCES["fdk_scale"])
        assert abs(found[middle] - right[middle]).max() < 2 * TOLERANCES["fdk_scale"] * right.max()


def test_a_shift_of_the_object_shifts_the_volume():
    """No half-voxel or half-pixel offset: the centre of mass is where the Gaussian is."""
    geometry = Geometry.circular(500, 800, 2 * np.pi / 60 * np.arange(60), Panel(40, 48, 1.6))
    centre = [2.3, -1.7, 0.6]
    volume = fdk(blobs([centre], 3.0).line_integrals(geometry).numpy(), geometry, GRID)[0]
    weights = np.where(volume > 0.1 * volume.max(), volume, 0)
    z, y, x = np.meshgrid(*(GRID.axis(name) for name in "zyx"), indexing="ij")
    found = [(weights * axis).sum() / weights.sum() for axis in (x, y, z)]
    np.testing.assert_allclose(found, centre, atol=0.05)


@pytest.mark.parametrize("geometry", [tilted(), circular(views=1)], ids=["free", "one view"])
def test_other_orbits_are_refused(geometry):
    images = np.zeros((len(geometry), 1, geometry.panel.rows, geometry.panel.columns), np.float32)
    with pytest.raises(GeometryError, match="needs a full circular orbit of at least two evenly spaced views"):
        fdk(images, geometry, GRID)
