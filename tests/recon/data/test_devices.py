"""A model on a GPU takes what it meets there: nothing of the fit stays behind on the host, or on the default device.

Without a GPU this is watched on the processor: arrays become tensors that refuse to meet others until they are sent to
a device, and tensors that are made without a device land on one without memory.
"""

from contextlib import contextmanager

import numpy as np
import pytest
import torch
from support.gaussian_scenes import circular, small_model, small_scan, spectral_model

from phantomgen.geometry.voxel_grid import Grid
from recon.data.devices import device_named
from recon.gaussians.fisher import coefficient_curvature
from recon.gaussians.initial.fit_to_volume import fit_to_volume
from recon.gaussians.likelihood import likelihood, likelihood_and_gradients
from recon.gaussians.model import PARTS
from recon.gaussians.state import FitState
from recon.gaussians.voxel_prior import VoxelPrior
from spectra.errors import InputError

GRID = Grid.cube(8, 14.0)
SENT = (torch.Tensor.to, torch.Tensor.numpy, torch.Tensor.cpu)


class Left(torch.Tensor):
    """A tensor that shares memory with an array and was not sent to any device."""

    @classmethod
    def __torch_function__(cls, function, types, args=(), kwargs=None):
        met = [a for a in args if isinstance(a, torch.Tensor) and not isinstance(a, Left) and a.numel() > 1]
        if met and function not in SENT:
            raise AssertionError(f"{function.__name__} brings an array to a tensor that may be on a GPU")
        out = super().__torch_function__(function, types, args, kwargs or {})
        return out.as_subclass(torch.Tensor) if function in SENT and isinstance(out, torch.Tensor) else out


@contextmanager
def watched(monkeypatch):
    with monkeypatch.context() as patch, torch.device("meta"):
        from_numpy = torch.from_numpy
        patch.setattr(torch, "from_numpy", lambda array: from_numpy(array).as_subclass(Left))
        yield


@pytest.fixture
def scan():
    return small_scan(small_model(1), circular(6, 7, views=3), spectral_model(), seed=1)


@pytest.fixture
def state():
    return FitState.begin(small_model(2))


@pytest.mark.parametrize("by_tensors", [False, True])
def test_the_likelihood(monkeypatch, scan, state, by_tensors):
    if by_tensors:  # as on a GPU
        monkeypatch.setattr("recon.gaussians.likelihood._has_kernel", lambda device: False)
    wanted = likelihood_and_gradients(state.gaussians, scan, np.arange(2), 0.01)
    gradients = [getattr(state.gaussians, name).grad.clone() for name in PARTS]
    with watched(monkeypatch):
        found = likelihood_and_gradients(state.gaussians, scan, np.arange(2), 0.01)
        everywhere = likelihood(state.gaussians, scan, 0.01)
    assert found.deviance == wanted.deviance
    assert everywhere.deviance > 0
    assert all(torch.equal(getattr(state.gaussians, n).grad, g) for n, g in zip(PARTS, gradients, strict=True))


def test_tensors_and_the_kernel_compute_the_same_likelihood(monkeypatch, scan, state):
    results = []
    for by_tensors in (False, True):
        monkeypatch.setattr("recon.gaussians.likelihood._has_kernel", lambda device, by=by_tensors: not by)
        found = likelihood_and_gradients(state.gaussians, scan, np.arange(2), 0.01)
        results.append((found, [getattr(state.gaussians, name).grad.clone() for name in PARTS]))
    (one, gradients), (other, others) = results
    assert one.deviance == pytest.approx(other.deviance, rel=1e-5)
    np.testing.assert_allclose(one.chi_square, other.chi_square, rtol=1e-4)
    for gradient, right in zip(gradients, others, strict=True):
        torch.testing.assert_close(gradient, right, rtol=1e-3, atol=1e-4 * float(right.abs().max()))


def test_the_curvature(monkeypatch, scan, state):
    wanted = coefficient_curvature(state.gaussians, scan, 0.01)
    with watched(monkeypatch):
        found = coefficient_curvature(state.gaussians, scan, 0.01)
    assert torch.equal(found, wanted)


def test_the_prior(monkeypatch, scan, state):
    volumes = small_model(3).volume(GRID)
    prior = VoxelPrior.of_volumes(volumes, GRID, np.eye(3), 0.3, 0.1)
    blocks = coefficient_curvature(state.gaussians, scan, 0.01)
    with watched(monkeypatch):
        both, metric = prior.curvature(state.gaussians, blocks)
        prior.add_gradients(state.gaussians, metric, 0)
    assert (torch.diagonal(both - blocks, dim1=1, dim2=2) > 0).any()
    assert state.gaussians.coefficients.grad.any()


def test_the_approximation(monkeypatch):
    volumes, start = small_model(3).volume(GRID), small_model(2)
    wanted = fit_to_volume(start, volumes, GRID, np.eye(3), 6)
    with watched(monkeypatch):
        found = fit_to_volume(start, volumes, GRID, np.eye(3), 6)
    assert torch.equal(found.centres, wanted.centres)


def test_a_state_takes_all_it_has_to_a_device(state):
    there = state.to(torch.device("meta"))
    assert {tensor.device.type for tensor in there.tensors().values()} == {"meta"}
    assert there.numbers() == state.numbers()
    assert state.to(torch.device("cpu")) is state


def test_a_gpu_that_is_not_there_is_one_sentence():
    if torch.cuda.is_available():
        pytest.skip("there is one")
    with pytest.raises(InputError, match="--device cuda needs a GPU"):
        device_named("cuda")


def test_the_watch_sees_what_is_left_behind(monkeypatch):
    here = torch.ones(3)
    with watched(monkeypatch):
        with pytest.raises(AssertionError, match="brings an array"):
            here * torch.from_numpy(np.ones(3, np.float32))
        with pytest.raises(RuntimeError, match="meta"):
            (here * torch.ones(3)).tolist()
        assert (here * torch.from_numpy(np.ones(3, np.float32)).to(here)).tolist() == [1, 1, 1]
