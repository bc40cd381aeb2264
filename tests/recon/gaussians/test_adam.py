"""Steps of Adam against torch's own."""

import pytest
import torch

from recon.gaussians.adam import TINY, Adam

DECAYS = 0.9, 0.99


@pytest.mark.parametrize("steps", [1, 2, 7])
def test_steps_are_those_of_torch(steps):
    random = torch.Generator().manual_seed(3)
    ours = [torch.randn(shape, generator=random).requires_grad_() for shape in [(5, 3), (4,)]]
    theirs = [tensor.detach().clone().requires_grad_() for tensor in ours]
    reference = torch.optim.Adam([{"params": [tensor]} for tensor in theirs], betas=DECAYS, eps=TINY)
    adam = Adam(ours)
    for number in range(1, steps + 1):
        rates = [0.1 / number, 0.02]
        for tensor, twin, group, rate in zip(ours, theirs, reference.param_groups, rates, strict=True):
            tensor.grad = torch.randn(tensor.shape, generator=random)
            twin.grad, group["lr"] = tensor.grad.clone(), rate
        adam.step(rates, number, DECAYS)
        reference.step()
    assert all(torch.equal(tensor, twin) for tensor, twin in zip(ours, theirs, strict=True))
