"""The voxelizer in Triton, in its interpreter or, with TRITON_INTERPRET=0, on a GPU."""

import os
import subprocess
import sys

import numpy as np
import pytest
import torch
from support.gaussian_scenes import REGIMES, one_gaussian, random_gaussians
from support.tolerances import TOLERANCES

from phantomgen.geometry.voxel_grid import Grid
from recon.ops.arguments import GaussianTensors
from recon.ops.voxelize import reference, voxelize_tensor

DEVICE = "cuda" if os.environ["TRITON_INTERPRET"] == "0" else "cpu"
OBLONG = Grid((7, 11, 9), (1.0, 1.2, 0.9), (-3.3, -6.0, -4.0))
COMPILE = """
from triton.backends.compiler import GPUTarget
from triton.compiler import ASTSource, compile
from recon.ops.voxelize import gpu

TYPES = dict.fromkeys(("numbers", "coefficients", "out", "cotangent", "sums", "to_coefficients"), "*fp32")
TYPES |= {"members": "*i64", "starts": "*i64", "places": "*i32", "k2": "fp32"}
TILE = {"DEEP": 4, "HIGH": 8, "WIDE": 8, "PADDED": 4}
for target in GPUTarget("cuda", 80, 32), GPUTarget("hip", "gfx942", 64):
    for kernel, fixed in (gpu._forward, TILE), (gpu._backward, {"BLOCK": 128, "PADDED": 4}):
        types = {name: TYPES.get(name, "i32") for name in kernel.arg_names} | dict.fromkeys(fixed, "constexpr")
        text = compile(ASTSource(kernel, types, fixed), target=target).asm
        print("atomic" if "atom" in text["ptx" if target.backend == "cuda" else "amdgcn"] else "plain")
"""


@pytest.fixture(scope="module")
def on_gpu():
    pytest.importorskip("triton")
    from recon.ops.voxelize.gpu_calls import voxelize_on_gpu

    def volume_and_gradients(parts, grid=OBLONG, footprint=1.0, cutoff=5.0, dtype=torch.float64):
        leaves = [part.to(DEVICE, dtype, copy=True).requires_grad_() for part in parts]
        volume = voxelize_on_gpu(GaussianTensors(*leaves), grid, footprint, cutoff)
        assert (volume.dtype, volume.device.type) == (dtype, DEVICE)
        gradients = torch.autograd.grad(volume, leaves, pull_of(volume).to(volume))
        assert [g.dtype for g in gradients] == 4 * [dtype]
        return [x.detach().cpu().double() for x in (volume, *gradients)]

    return volume_and_gradients


def pull_of(volume):
    return torch.from_numpy(np.random.default_rng(0).normal(size=tuple(volume.shape)))


def by(function, parts):
    leaves = [part.clone().requires_grad_() for part in parts]
    volume = function(*leaves)
    gradients = torch.autograd.grad(volume, leaves, pull_of(volume).to(volume))
    return [x.detach().double() for x in (volume, *gradients)]


def by_reference(parts, grid=OBLONG):
    axes = tuple(torch.from_numpy(grid.axis(name)) for name in "zyx")
    return by(lambda *p: reference.voxelize(*p, axes, grid.spacing), parts)


def assert_same(found, expected):
    assert (found[0] - expected[0]).abs().max() < TOLERANCES["kernel_value"] * expected[0].abs().max()
    for gradient, wanted in zip(found[1:], expected[1:], strict=True):
        assert (gradient - wanted).norm() < TOLERANCES["kernel_gradient"] * wanted.norm()


@pytest.mark.parametrize("bases", [1, 3])
@pytest.mark.parametrize("regime", REGIMES)
def test_kernels_give_the_values_and_gradients_of_the_reference(on_gpu, regime, bases):
    parts = random_gaussians(1, count=6, bases=bases, sigma=REGIMES[regime], spread=3.0)
    assert_same(on_gpu(parts), by_reference(parts))


@pytest.mark.parametrize(("footprint", "cutoff"), [(0.0, 5.0), (1.0, 2.5), (2.0, 4.5)])
def test_triton_and_numba_cut_the_same_and_agree_over_several_tiles(on_gpu, footprint, cutoff):
    """Gaussians over several tiles, beside the grid, and on its faces; in float32."""
    parts = [part.float() for part in random_gaussians(5, count=10, spread=9.0, sigma=(0.6, 2.0))]
    found = on_gpu(parts, footprint=footprint, cutoff=cutoff, dtype=torch.float32)
    expected = by(lambda *p: voxelize_tensor(*p, OBLONG, footprint, cutoff), parts)
    for a, b in zip(found, expected, strict=True):
        assert (a - b).norm() < TOLERANCES["kernel_value"] * b.norm()


def test_part_of_a_grid_equals_that_part_of_the_whole_bit_for_bit(on_gpu):
    """Slices that begin inside a tile of the whole."""
    parts = random_gaussians(3, count=6, sigma=REGIMES["needle"], spread=4.0)
    whole = on_gpu(parts, dtype=torch.float32)[0]
    for first, count in ((0, 3), (3, 1), (2, 5)):
        assert torch.equal(
            on_gpu(parts, OBLONG.slices(first, count), dtype=torch.float32)[0], whole[:, first:][:, :count]
        )


@pytest.mark.parametrize("place", [[1e9, 0.0, 0.0], [0.0, -1e4, 0.0]])
def test_a_gaussian_far_outside_leaves_no_trace(on_gpu, place):
    assert not any(x.any() for x in on_gpu(one_gaussian(place, 1.0)))


def test_no_gaussians(on_gpu):
    volume, *gradients = on_gpu([part[:0] for part in random_gaussians(1)])
    assert volume.shape == (3, *OBLONG.shape)
    assert not volume.any()
    assert [tuple(g.shape) for g in gradients] == [(0, 3), (0, 3), (0, 4), (0, 3)]


def test_kernels_compile_for_gpus_without_atomic_sums(on_gpu, tmp_path):
    environment = {**os.environ, "TRITON_INTERPRET": "0", "TRITON_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", COMPILE]
    found = subprocess.run(command, env=environment, capture_output=True, encoding="utf-8", check=False)
    assert found.returncode == 0, found.stderr
    assert found.stdout.split() == 4 * ["plain"]
