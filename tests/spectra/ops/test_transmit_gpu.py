"""The transmission operator in Triton, in its interpreter or, with TRITON_INTERPRET=0, on a GPU."""

import os
import subprocess
import sys

import numpy as np
import pytest
import torch

from spectra.differentiable import transmit
from spectra.ops.transmit import reference
from spectra.transmission import Transmission

DEVICE = "cuda" if os.environ["TRITON_INTERPRET"] == "0" else "cpu"
COMPILE = """
from triton.backends.compiler import GPUTarget
from triton.compiler import ASTSource, compile
from spectra.ops.transmit import gpu

for target in GPUTarget("cuda", 80, 32), GPUTarget("hip", "gfx942", 64):
    for kernel in gpu._forward, gpu._backward:
        fixed = {"BLOCK": 128, "PADDED": 4}
        types = dict.fromkeys(("lengths", "columns", "weights", "cotangents", "out"), "*fp32")
        types |= {"starts": "*i64", "highest": "fp32", **dict.fromkeys(fixed, "constexpr")}
        source = ASTSource(kernel, {name: types.get(name, "i32") for name in kernel.arg_names}, fixed)
        text = compile(source, target=target).asm["ptx" if target.backend == "cuda" else "amdgcn"]
        print("atomic" if "atom" in text else "plain")
"""
RELATIVE = {torch.float32: 3e-6, torch.float64: 1e-12}


@pytest.fixture(scope="module")
def operator():
    pytest.importorskip("triton")
    from spectra.differentiable import TransmitOnGpu

    return TransmitOnGpu.apply


def random_model(rng, bases, sizes):
    starts = np.concatenate([[0], np.cumsum(sizes)])
    return Transmission(rng.uniform(0.05, 1, (bases, starts[-1])), rng.uniform(0.1, 5, starts[-1]), starts)


def reference_of(model, lengths):
    columns, weights = (torch.tensor(array) for array in (model.columns, model.weights))
    return reference.transmit(lengths, columns, weights, model.starts.tolist())


@pytest.mark.parametrize("dtype", RELATIVE)
@pytest.mark.parametrize(("bases", "sizes"), [(1, [1]), (2, [3, 0, 5]), (3, [4, 9, 1]), (5, [20])])
def test_values_and_gradients_are_those_of_the_formula(operator, bases, sizes, dtype):
    rng = np.random.default_rng(bases)
    model = random_model(rng, bases, sizes)
    lengths = torch.tensor(rng.uniform(-1, 6, (150, bases)), requires_grad=True)
    cotangent = torch.tensor(rng.normal(size=(150, len(sizes))))
    truth = reference_of(model, lengths)
    (slope,) = torch.autograd.grad(truth, lengths, cotangent)
    ours = lengths.detach().to(device=DEVICE, dtype=dtype).requires_grad_()
    counts = operator(ours, model)
    counts.backward(cotangent.to(ours))
    assert (counts.dtype, counts.device.type) == (dtype, DEVICE)
    rtol = RELATIVE[dtype]
    np.testing.assert_allclose(counts.detach().cpu().double(), truth.detach(), rtol=rtol)
    scale = torch.autograd.grad(reference_of(model, lengths), lengths, cotangent.abs())[0].abs()
    assert ((ours.grad.cpu().double() - slope).abs() <= 3 * rtol * scale).all()


def test_triton_and_numba_agree_and_pass_gradcheck(operator):
    rng = np.random.default_rng(9)
    model = random_model(rng, 3, [4, 6])
    lengths = torch.tensor(rng.uniform(0, 3, (2, 3, 3)), device=DEVICE, requires_grad=True)
    numba = transmit(lengths.detach().cpu(), model)
    np.testing.assert_allclose(operator(lengths, model).detach().cpu(), numba, rtol=1e-12)
    assert torch.autograd.gradcheck(lambda x: operator(x, model), lengths)


@pytest.mark.parametrize("dtype", RELATIVE)
def test_extreme_paths_stay_finite(operator, transmission_on, dtype):
    model = transmission_on(64)
    for value in (-1e4, -1.0, 0.0, 60.0, 1e4, 1e30):
        lengths = torch.full((1, 3), value, dtype=dtype, device=DEVICE, requires_grad=True)
        counts = operator(lengths, model)
        assert torch.isfinite(counts).all()
        if abs(value) < 1e4:
            counts.sum().backward()
            assert torch.isfinite(lengths.grad).all()


def test_no_rays(operator):
    model = random_model(np.random.default_rng(0), 2, [3])
    lengths = torch.zeros((0, 2), device=DEVICE, requires_grad=True)
    operator(lengths, model).sum().backward()
    assert lengths.grad.shape == (0, 2)


def test_kernels_compile_for_gpus_without_atomic_sums(operator, tmp_path):
    environment = {**os.environ, "TRITON_INTERPRET": "0", "TRITON_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", COMPILE]
    found = subprocess.run(command, env=environment, capture_output=True, encoding="utf-8", check=False)
    assert found.returncode == 0, found.stderr
    assert found.stdout.split() == 4 * ["plain"]
