"""Divided Gaussians in Triton, in its interpreter or, with TRITON_INTERPRET=0, on a GPU."""

import os
import subprocess
import sys

import numpy as np
import pytest
import torch
from support.gaussian_scenes import REGIMES, circular, frames_of, one_gaussian, random_gaussians
from support.tolerances import TOLERANCES

from phantomgen.geometry.voxel_grid import Grid
from recon.ops.interface.arrays import DividedTensors
from recon.ops.interface.rasterize import near_the_ends, rasterize_divided
from recon.ops.interface.reference import line_integrals
from recon.ops.interface.voxelize import voxelize_divided
from recon.ops.rasterize.projector import Projector

DEVICE = "cuda" if os.environ["TRITON_INTERPRET"] == "0" else "cpu"
OBLONG = Grid((7, 11, 9), (1.0, 1.2, 0.9), (-3.3, -6.0, -4.0))
COMPILE = """
from triton.backends.compiler import GPUTarget
from triton.compiler import ASTSource, compile
from recon.ops.interface.gpu import pixels, voxels

FLOATS = "numbers", "below", "step", "out", "cotangent", "sums", "to_below", "to_step"
TYPES = dict.fromkeys(FLOATS, "*fp32") | {"members": "*i64", "starts": "*i64", "k2": "fp32"}
TYPES |= {"bounds": "*i32", "places": "*i32"}
TILE = {"DEEP": 4, "HIGH": 8, "WIDE": 8, "PADDED": 4}
BLOCK = {"BLOCK": 128, "PADDED": 4}
for target in GPUTarget("cuda", 80, 32), GPUTarget("hip", "gfx942", 64):
    for kernel, fixed in (
        (pixels._forward, {"TILE": 16, "PADDED": 4}), (pixels._backward, BLOCK),
        (voxels._forward, TILE), (voxels._backward, BLOCK),
    ):
        types = {name: TYPES.get(name, "i32") for name in kernel.arg_names} | dict.fromkeys(fixed, "constexpr")
        text = compile(ASTSource(kernel, types, fixed), target=target).asm
        print("atomic" if "atom" in text["ptx" if target.backend == "cuda" else "amdgcn"] else "plain")
"""


def divided(seed, width=0.3, bases=2, **options):
    """Random Gaussians, each divided by a plane near its centre, float64."""
    random = np.random.default_rng(seed)
    *shape, above = random_gaussians(seed, bases=bases, **options)
    planes = np.stack([random.normal(0, 0.7, len(above)), np.full(len(above), width)], axis=1)
    return (*shape, torch.from_numpy(planes), torch.from_numpy(random.uniform(-0.5, 1.0, above.shape)), above)


def values_and_gradients(function, parts, device="cpu", dtype=torch.float64):
    leaves = [part.to(device, dtype, copy=True).requires_grad_() for part in parts]
    values = function(DividedTensors(*leaves))
    weights = torch.from_numpy(np.random.default_rng(0).normal(size=tuple(values.shape)))
    gradients = torch.autograd.grad(values, leaves, weights.to(values))
    assert {x.dtype for x in gradients} == {dtype}
    return [x.detach().cpu().double() for x in (values, *gradients)]


@pytest.fixture(scope="module")
def gpu():
    pytest.importorskip("triton")
    from recon.ops.interface.gpu import calls

    return calls


def seen_on_gpu(gpu, geometry, projector):
    def images(gaussians):
        of, panel = frames_of(geometry), (geometry.panel.rows, geometry.panel.columns)
        found, near = gpu.rasterize_on_gpu(gaussians, of, panel, projector)
        return found + near_the_ends(gaussians, near, of, panel, projector) if near.any() else found

    return images


def seen(geometry, projector):
    panel = geometry.panel.rows, geometry.panel.columns
    return lambda gaussians: rasterize_divided(gaussians, frames_of(geometry), panel, projector)


def by_reference(geometry):
    rows, columns = geometry.panel.rows, geometry.panel.columns
    y, x = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in (rows, columns)), indexing="ij")

    def images(gaussians):
        found = []
        for frame in frames_of(geometry):
            directions = (frame[1] + x[..., None] * frame[2] + y[..., None] * frame[3]).reshape(-1, 3)
            values = line_integrals(gaussians, frame[:1].expand(directions.shape), directions)
            found.append(values.T.reshape(-1, rows, columns))
        return torch.stack(found)

    return images


def assert_same(found, expected, value="kernel_value", gradient="kernel_gradient"):
    assert (found[0] - expected[0]).abs().max() < TOLERANCES[value] * expected[0].abs().max()
    for ours, wanted in zip(found[1:], expected[1:], strict=True):
        assert (ours - wanted).norm() < TOLERANCES[gradient] * wanted.norm()


@pytest.mark.parametrize("width", [0.02, 0.3, 2.0])
@pytest.mark.parametrize("regime", ["narrow", "typical", "needle"])
def test_rays_and_gradients_are_those_of_the_reference(gpu, regime, width):
    geometry, parts = circular(9, 11, views=3, pitch=2.0), divided(3, width, count=6, sigma=REGIMES[regime])
    found = values_and_gradients(seen_on_gpu(gpu, geometry, Projector(0.0, 5.0)), parts, DEVICE)
    assert_same(found, values_and_gradients(by_reference(geometry), parts))


@pytest.mark.parametrize("bases", [1, 3])
def test_pixels_and_gradients_agree_with_numba(gpu, bases):
    """Means over pixels, over several tiles of several views, beside the panel."""
    geometry, parts = circular(19, 35, views=2, pitch=0.6), divided(5, bases=bases, count=8, spread=9.0)
    found = values_and_gradients(seen_on_gpu(gpu, geometry, Projector(1.0, 4.0)), parts, DEVICE)
    assert_same(found, values_and_gradients(seen(geometry, Projector(1.0, 4.0)), parts))


def test_some_views_at_a_time_give_the_same_bits(gpu, monkeypatch):
    geometry, parts = circular(9, 11, views=3), divided(1, count=5)
    whole = values_and_gradients(seen_on_gpu(gpu, geometry, Projector()), parts, DEVICE)
    monkeypatch.setattr("recon.ops.rasterize.gpu_calls.SEEN_AT_ONCE", 1)
    assert torch.equal(whole[0], values_and_gradients(seen_on_gpu(gpu, geometry, Projector()), parts, DEVICE)[0])


@pytest.mark.parametrize("centre", [[58.0, 1.0, 2.0], [-38.0, 3.0, 0.0], [90.0, 0.0, 0.0]])
def test_gaussians_at_the_ends_of_rays(gpu, centre):
    geometry, others = circular(9, 7, views=2), divided(2, count=2)
    end = one_gaussian(centre, 3.0, bases=2)
    end = (*end[:3], torch.tensor([[0.2, 0.1]], dtype=torch.float64), 0.5 * end[3], end[3])
    parts = [torch.cat(pair) for pair in zip(end, others, strict=True)]
    found = values_and_gradients(seen_on_gpu(gpu, geometry, Projector(1.0, 4.0)), parts, DEVICE)
    assert_same(found, values_and_gradients(seen(geometry, Projector(1.0, 4.0)), parts))


@pytest.mark.parametrize("width", [0.02, 0.3])
@pytest.mark.parametrize("regime", REGIMES)
def test_voxels_and_gradients_agree_with_numba(gpu, regime, width):
    parts = divided(4, width, count=9, sigma=REGIMES[regime], spread=6.0)
    found = values_and_gradients(lambda gaussians: gpu.voxelize_on_gpu(gaussians, OBLONG, 4.2), parts, DEVICE)
    assert_same(found, values_and_gradients(lambda gaussians: voxelize_divided(gaussians, OBLONG, 4.2), parts))


def test_part_of_a_grid_equals_that_part_of_the_whole_bit_for_bit(gpu):
    parts = DividedTensors(*(part.to(DEVICE) for part in divided(6, count=6, spread=4.0)))
    whole = gpu.voxelize_on_gpu(parts, OBLONG, 4.0)
    for first, count in ((0, 3), (3, 1), (2, 5)):
        assert torch.equal(gpu.voxelize_on_gpu(parts, OBLONG.slices(first, count), 4.0), whole[:, first:][:, :count])


def test_no_gaussians_and_no_views(gpu):
    nothing, geometry = [part[:0] for part in divided(1)], circular(3, 4)
    for function, shape in (
        (seen_on_gpu(gpu, geometry, Projector()), (len(geometry), 2, 3, 4)),
        (seen_on_gpu(gpu, geometry[:0], Projector()), (0, 2, 3, 4)),
        (lambda gaussians: gpu.voxelize_on_gpu(gaussians, OBLONG, 4.0), (2, *OBLONG.shape)),
    ):
        values, *gradients = values_and_gradients(function, nothing, DEVICE)
        assert tuple(values.shape) == shape
        assert not values.any()
        assert [len(g) for g in gradients] == [0] * 6


def test_kernels_compile_for_gpus_without_atomic_sums(gpu, tmp_path):
    environment = {**os.environ, "TRITON_INTERPRET": "0", "TRITON_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", COMPILE]
    found = subprocess.run(command, env=environment, capture_output=True, encoding="utf-8", check=False)
    assert found.returncode == 0, found.stderr
    assert found.stdout.split() == 8 * ["plain"]
