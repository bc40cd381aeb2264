"""The voxel projector for tensors. Triton runs in its interpreter or, with TRITON_INTERPRET=0, on a GPU."""

import os
import subprocess
import sys

import numpy as np
import pytest
import torch

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.project import _in_voxels, project, project_transpose
from phantomgen.ops.project.reference import matrix_of_view
from spectra.errors import InputError

DEVICE = "cuda" if os.environ["TRITON_INTERPRET"] == "0" else "cpu"
GRID = Grid((5, 6, 7), (1.3, 0.9, 1.1), (-2.0, -3.0, -2.5))
ROWS, COLUMNS = 4, 5
CIRCLE = Geometry.circular(30.0, 60.0, np.array([0.1, 0.9, 1.6]), Panel(ROWS, COLUMNS, (2.3, 3.1))).ray_frames()
ASKEW = np.array([[[15, 4, 3], [-31, -14, -5], [0.9, -0.4, 1.5], [-1.2, 1.3, 0.6]]])
COARSE = np.array([[[1.0, 0.5, 20], [-6, -5.5, -33], [3.1, 0.2, 0.1], [0.1, 2.9, -0.1]]])
INSIDE = np.array([[[0.3, 0.2, 0.1], [-8, -2.5, -2], [4, 0, 0], [0, 0, 1.1]]])
ONE_LINE = np.array([[[-20, 1, 0], [40, -4, 0.5], [0.1, 1.7, 0], [0, 0, 0]]])
PARALLEL = np.array([[[-30.0, 9, 4], [12.0, -7, -3], [0.3, 1.7, 0.1], [0, 0.1, 1.2]]])
VIEWS = {
    "circle": (CIRCLE, False),
    "askew": (ASKEW, False),
    "coarse": (COARSE, False),
    "source inside": (INSIDE, False),
    "rows alike": (ONE_LINE, False),
    "parallel": (PARALLEL, True),
}
COMPILE = """
from triton.backends.compiler import GPUTarget
from triton.compiler import ASTSource, compile
from phantomgen.ops.project import gpu

POINTERS = {"table", "inverses", "reaches", "images", "volume", "out"}
for target in GPUTarget("cuda", 80, 32), GPUTarget("hip", "gfx942", 64):
    for kernel, taps in (gpu._forward, {"TAPS_A": 2, "TAPS_B": 3}), (gpu._backward, {}):
        fixed = {**taps, "BLOCK": 128, "COMPONENTS": 2}
        types = {name: "*fp32" if name in POINTERS else "i32" for name in kernel.arg_names}
        source = ASTSource(kernel, {**types, **dict.fromkeys(fixed, "constexpr")}, fixed)
        text = compile(source, target=target).asm["ptx" if target.backend == "cuda" else "amdgcn"]
        print("atomic" if "atom" in text else "plain")
"""


@pytest.fixture(scope="module")
def gpu():
    pytest.importorskip("triton")
    from phantomgen.ops.project import gpu

    return gpu


def both_ways(gpu, volume, images, grid, frames, parallel):
    """What Triton makes of arrays, in float64."""
    views, spacing = _in_voxels(frames, grid, parallel)
    volume, images = (torch.tensor(values, dtype=torch.float32, device=DEVICE) for values in (volume, images))
    forward = gpu.forward(volume, views, parallel, spacing, *images.shape[2:])
    backward = gpu.backward(images, views, parallel, spacing, grid.shape)
    return forward.cpu().double().numpy(), backward.cpu().double().numpy()


@pytest.mark.parametrize(("frames", "parallel"), VIEWS.values(), ids=VIEWS)
def test_kernels_are_the_matrix_and_its_transpose(gpu, frames, parallel):
    rng = np.random.default_rng(1)
    volume = rng.random((3, *GRID.shape), np.float32)
    images = rng.random((3, len(frames), ROWS, COLUMNS), np.float32)
    matrix = np.concatenate([matrix_of_view(frame, ROWS, COLUMNS, GRID, parallel) for frame in frames])
    assert (matrix.sum(axis=1) > 0).sum() >= 15  # most rays do meet the volume
    forward, backward = both_ways(gpu, volume, images, GRID, frames, parallel)
    np.testing.assert_allclose(forward.reshape(3, -1), volume.reshape(3, -1) @ matrix.T, rtol=2e-6, atol=2e-6)
    np.testing.assert_allclose(backward.reshape(3, -1), images.reshape(3, -1) @ matrix, rtol=2e-6, atol=2e-6)
    assert (forward * images).sum() == pytest.approx((volume * backward).sum(), rel=1e-6)


def test_several_blocks_tables_and_groups_of_components(gpu, monkeypatch):
    monkeypatch.setattr(gpu, "_BLOCK", 16)
    monkeypatch.setattr(gpu, "_RAYS", ROWS * COLUMNS)
    rng, frames, grid = np.random.default_rng(2), CIRCLE[:2], Grid((2, 4, 5), (3.0, 1.2, 1.4), (-1.5, -1.8, -2.8))
    volume, images = rng.random((5, *grid.shape)), rng.random((5, 2, ROWS, COLUMNS))
    forward, backward = both_ways(gpu, volume, images, grid, frames, False)
    np.testing.assert_allclose(forward, project(volume, grid, frames, ROWS, COLUMNS), rtol=2e-6, atol=2e-6)
    np.testing.assert_allclose(backward, project_transpose(images, grid, frames), rtol=2e-6, atol=2e-6)


@pytest.mark.slow
def test_kernels_compile_for_gpus_without_atomic_sums(gpu, tmp_path):
    environment = {**os.environ, "TRITON_INTERPRET": "0", "TRITON_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", COMPILE]
    found = subprocess.run(command, env=environment, capture_output=True, encoding="utf-8", check=False)
    assert found.returncode == 0, found.stderr
    assert found.stdout.split() == 4 * ["plain"]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_tensors_give_tensors_that_carry_gradients(dtype):
    rng = np.random.default_rng(3)
    volume, images = rng.random((2, *GRID.shape)), rng.random((2, 3, ROWS, COLUMNS))
    x = torch.tensor(volume, dtype=dtype, device=DEVICE, requires_grad=True)
    y = torch.tensor(images, dtype=dtype, device=DEVICE, requires_grad=True)
    forward, backward = project(x, GRID, CIRCLE, ROWS, COLUMNS), project_transpose(y, GRID, CIRCLE)
    (forward * y.detach()).sum().backward()
    (backward * x.detach()).sum().backward()
    wanted = (project(volume, GRID, CIRCLE, ROWS, COLUMNS), project_transpose(images, GRID, CIRCLE)) * 2
    for found, array, kind in zip(
        (forward, backward, y.grad, x.grad), wanted, 2 * [torch.float32] + 2 * [dtype], strict=True
    ):
        assert (found.dtype, found.device.type) == (kind, DEVICE)
        np.testing.assert_allclose(found.detach().cpu().numpy(), array, rtol=2e-6, atol=2e-6)


def test_refuses_other_devices():
    with pytest.raises(InputError, match="on the devices cpu and cuda, but the tensor is on meta"):
        project(torch.zeros((1, *GRID.shape), device="meta"), GRID, CIRCLE, ROWS, COLUMNS)
