"""Moments of the sides of divided Gaussians: against scipy, also where a plane is far away."""

import numpy as np
import pytest
import torch
from scipy.stats import truncnorm

from recon.ops.interface.sides import LEAST_VARIANCE, side_moments

CUTS = [-6.0, -2.5, -0.3, 0.0, 0.4, 1.0, 3.0, 6.0]
FAR = [-1e6, -143.2, -31.0, -12.0, -8.5, 8.5, 12.0, 143.2, 1e6]


@pytest.mark.parametrize("above", [False, True])
@pytest.mark.parametrize("cut", CUTS)
def test_moments_are_those_of_cut_normal_distributions(cut, above):
    mass, mean, spread = (float(part) for part in side_moments(torch.tensor([cut], dtype=torch.float64), above))
    side = truncnorm(cut, np.inf) if above else truncnorm(-np.inf, cut)
    assert mass == pytest.approx(truncnorm(-np.inf, np.inf).sf(cut) if above else truncnorm(-np.inf, np.inf).cdf(cut))
    assert mean == pytest.approx(side.mean(), abs=1e-9)
    assert spread == pytest.approx(side.std(), rel=1e-6)


@pytest.mark.parametrize("kind", [torch.float32, torch.float64])
@pytest.mark.parametrize("above", [False, True])
def test_far_planes_leave_numbers_and_gradients_finite(above, kind):
    cuts = torch.tensor(FAR, dtype=kind, requires_grad=True)
    moments = side_moments(cuts, above)
    sum(part.sum() for part in moments).backward()
    for part in (*moments, cuts.grad):
        assert torch.isfinite(part).all()
    assert (moments.spread >= 0.99 * LEAST_VARIANCE**0.5).all()
    whole = (cuts < 0) if above else (cuts > 0)
    torch.testing.assert_close(moments.mass, whole.to(kind), atol=1e-15, rtol=1e-6)
    torch.testing.assert_close(moments.spread[whole], torch.ones(int(whole.sum()), dtype=kind))
