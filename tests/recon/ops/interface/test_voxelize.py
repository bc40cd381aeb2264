import numpy as np
import pytest
import torch

from phantomgen.geometry.voxel_grid import Grid
from recon.ops.interface.arrays import DividedTensors
from recon.ops.interface.voxelize import voxelize_divided
from recon.ops.rasterize.reference import whitening
from recon.ops.voxelize import voxelize_tensor

GRID = Grid((14, 15, 16), (2.0, 2.0, 2.0), (-13.0, -14.0, -15.0))
BASES = 2


def gaussians(count: int = 10, seed: int = 2, width: float = 0.2) -> tuple[torch.Tensor, ...]:
    random = np.random.default_rng(seed)
    scales = np.log(random.uniform(1.5, 5.0, (count, 3)))
    planes = np.stack([random.normal(0, 0.7, count), np.full(count, width)], axis=1)
    parts = [random.uniform(-7, 7, (count, 3)), scales, random.normal(size=(count, 4)), planes]
    return tuple(torch.from_numpy(p) for p in [*parts, *random.uniform(0, 0.05, (2, count, BASES))])


def means(parts: tuple[torch.Tensor, ...], finer: int = 8) -> torch.Tensor:
    """Means over voxels of `finer`^3 points each."""
    centres, scales, turns, planes, below, above = parts
    axes = []
    for n, s, o in zip(GRID.shape, GRID.spacing, GRID.origin, strict=True):
        axes.append(o + s * ((torch.arange(n * finer, dtype=torch.float64) + 0.5) / finer - 0.5))
    z, y, x = torch.meshgrid(*axes, indexing="ij")
    points = torch.stack([x, y, z], -1).reshape(-1, 3)
    volume = torch.zeros(BASES, len(points), dtype=torch.float64)
    for g, matrix in enumerate(whitening(scales, turns)):
        w = (points - centres[g]) @ matrix.T
        bell = torch.exp(-0.5 * (w * w).sum(-1))
        part = torch.special.ndtr((w[:, 2] - planes[g, 0]) / planes[g, 1])
        volume += bell * (below[g][:, None] + (above[g] - below[g])[:, None] * part)
    nz, ny, nx = GRID.shape
    return volume.reshape(BASES, nz, finer, ny, finer, nx, finer).mean(dim=(2, 4, 6))


def test_voxels_hold_means():
    parts = gaussians()
    wanted, found = means(parts), voxelize_divided(DividedTensors(*parts), GRID, 5.0)
    assert float((found - wanted).abs().max()) < 0.02 * float(wanted.max())


def test_sides_that_agree_make_a_plain_gaussian():
    parts = gaussians()
    found = voxelize_divided(DividedTensors(*parts[:5], parts[4]), GRID, 4.5)
    wanted = voxelize_tensor(*(p.float() for p in (*parts[:3], parts[4])), GRID, cutoff=4.5)
    torch.testing.assert_close(found.float(), wanted, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("part", range(6), ids=["centres", "scales", "turns", "planes", "below", "above"])
def test_gradients_are_those_of_differences(part):
    weights = torch.from_numpy(np.random.default_rng(4).normal(size=(BASES, *GRID.shape)))
    random = np.random.default_rng(part)

    def value(parts):
        return (voxelize_divided(DividedTensors(*parts), GRID, 5.0).double() * weights).sum()

    parts = gaussians()
    parts[part].requires_grad_()
    value(parts).backward()
    way = torch.from_numpy(random.normal(size=parts[part].shape))
    h = 1e-2 if part < 4 else 1e-3
    ends = [[p.detach() + sign * h * way if i == part else p.detach() for i, p in enumerate(parts)] for sign in (1, -1)]
    wanted = float((value(ends[0]) - value(ends[1])) / (2 * h))
    found = float((parts[part].grad * way).sum())
    scale = float((parts[part].grad.abs() * way.abs()).sum())
    assert found == pytest.approx(wanted, abs=2e-3 * scale)
