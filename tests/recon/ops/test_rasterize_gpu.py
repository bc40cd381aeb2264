"""The rasterizer in Triton, in its interpreter or, with TRITON_INTERPRET=0, on a GPU."""

import os
import subprocess
import sys

import numpy as np
import pytest
import torch
from support.gaussian_scenes import GEOMETRIES, REGIMES, circular, frames_of, one_gaussian, random_gaussians
from support.tolerances import TOLERANCES

from recon.ops.arguments import GaussianTensors
from recon.ops.rasterize import Projector, rasterize, reference

NEARLY_UNCUT = Projector(cutoff=5.0)
DEVICE = "cuda" if os.environ["TRITON_INTERPRET"] == "0" else "cpu"
COMPILE = """
from triton.backends.compiler import GPUTarget
from triton.compiler import ASTSource, compile
from recon.ops.rasterize import gpu

TYPES = dict.fromkeys(("numbers", "coefficients", "out", "cotangent", "sums", "to_coefficients"), "*fp32")
TYPES |= {"members": "*i64", "starts": "*i64", "bounds": "*i32", "k2": "fp32"}
for target in GPUTarget("cuda", 80, 32), GPUTarget("hip", "gfx942", 64):
    for kernel, fixed in (gpu._forward, {"TILE": 16, "PADDED": 4}), (gpu._backward, {"BLOCK": 128, "PADDED": 4}):
        types = {name: TYPES.get(name, "i32") for name in kernel.arg_names} | dict.fromkeys(fixed, "constexpr")
        text = compile(ASTSource(kernel, types, fixed), target=target).asm
        print("atomic" if "atom" in text["ptx" if target.backend == "cuda" else "amdgcn"] else "plain")
"""


@pytest.fixture(scope="module")
def on_gpu():
    pytest.importorskip("triton")
    from recon.ops.rasterize.gpu_calls import rasterize_on_gpu

    def image_and_gradients(parts, geometry, projector=NEARLY_UNCUT, dtype=torch.float64):
        panel, leaves = geometry.panel, [part.to(DEVICE, dtype, copy=True).requires_grad_() for part in parts]
        image = rasterize_on_gpu(GaussianTensors(*leaves), frames_of(geometry), (panel.rows, panel.columns), projector)
        assert (image.dtype, image.device.type) == (dtype, DEVICE)
        gradients = torch.autograd.grad(image, leaves, pull_of(image).to(image))
        assert [g.dtype for g in gradients] == 4 * [dtype]
        return [x.detach().cpu().double() for x in (image, *gradients)]

    return image_and_gradients


def pull_of(image):
    return torch.from_numpy(np.random.default_rng(0).normal(size=image.shape))


def by(function, parts, geometry, projection=1.0):
    leaves = [part.clone().requires_grad_() for part in parts]
    image = function(*leaves, frames_of(geometry), geometry.panel.rows, geometry.panel.columns, projection)
    gradients = torch.autograd.grad(image, leaves, pull_of(image).to(image))
    return [x.detach().double() for x in (image, *gradients)]


def assert_same(found, expected):
    assert (found[0] - expected[0]).abs().max() < TOLERANCES["kernel_value"] * expected[0].abs().max()
    for gradient, wanted in zip(found[1:], expected[1:], strict=True):
        assert (gradient - wanted).norm() < TOLERANCES["kernel_gradient"] * wanted.norm()


@pytest.mark.parametrize("footprint", [0.0, 1.0])
@pytest.mark.parametrize("regime", REGIMES)
@pytest.mark.parametrize(("where", "bases"), [("even-odd", 1), ("tilted", 3)])
def test_kernels_give_the_values_and_gradients_of_the_reference(on_gpu, where, bases, regime, footprint):
    geometry, parts = GEOMETRIES[where], random_gaussians(3, count=6, bases=bases, sigma=REGIMES[regime])
    assert_same(on_gpu(parts, geometry, Projector(footprint, 5.0)), by(reference.rasterize, parts, geometry, footprint))


def test_local_affine_projection(on_gpu):
    geometry, parts = GEOMETRIES["tilted"], random_gaussians(4, count=6, bases=2)
    found = on_gpu(parts, geometry, Projector(cutoff=5.0, kind="local-affine"))
    assert_same(found, by(reference.local_affine, parts, geometry))


@pytest.mark.parametrize("centre", [[58.0, 1.0, 2.0], [-38.0, 3.0, 0.0], [60.0, 0.0, 0.0], [90.0, 0.0, 0.0]])
@pytest.mark.parametrize("sigma", [0.3, 3.0])
def test_gaussians_at_the_ends_of_rays(on_gpu, centre, sigma):
    geometry = circular(9, 7, views=2)
    ends, others = one_gaussian(centre, sigma, bases=2), random_gaussians(2, count=2, bases=2)
    parts = [torch.cat(pair) for pair in zip(ends, others, strict=True)]
    assert_same(on_gpu(parts, geometry), by(reference.rasterize, parts, geometry))


def test_triton_and_numba_cut_the_same_and_agree_over_several_tiles(on_gpu):
    """Footprints over several tiles, beside the panel, and none at all; in float32."""
    geometry, parts = circular(19, 35, views=2, pitch=0.6), random_gaussians(5, count=8, spread=9.0)
    found = on_gpu(parts, geometry, Projector(cutoff=3.7), torch.float32)
    expected = by(rasterize, [part.float() for part in parts], geometry, Projector(cutoff=3.7))
    for a, b in zip(found, expected, strict=True):
        assert (a - b).norm() < TOLERANCES["kernel_value"] * b.norm()


def test_no_gaussians_and_no_views(on_gpu):
    nothing = [part[:0] for part in random_gaussians(1)]
    image, *gradients = on_gpu(nothing, circular(3, 4))
    assert image.shape == (3, 3, 3, 4)
    assert not image.any()
    assert [tuple(g.shape) for g in gradients] == [(0, 3), (0, 3), (0, 4), (0, 3)]
    parts = random_gaussians(1)
    image, *gradients = on_gpu(parts, circular(3, 4)[:0])
    assert image.shape == (0, 3, 3, 4)
    assert not any(gradient.any() for gradient in gradients)


def test_kernels_compile_for_gpus_without_atomic_sums(on_gpu, tmp_path):
    environment = {**os.environ, "TRITON_INTERPRET": "0", "TRITON_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", COMPILE]
    found = subprocess.run(command, env=environment, capture_output=True, encoding="utf-8", check=False)
    assert found.returncode == 0, found.stderr
    assert found.stdout.split() == 4 * ["plain"]
