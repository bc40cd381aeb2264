"""Lattice of displacements: an adjoint pair that is exact for linear fields; phases begin equal."""

import pytest
import torch

from recon.gaussians.model import Gaussians
from recon.phases.model import Lattice, PhaseGaussians

POINTS = torch.rand(40, 3, generator=torch.Generator().manual_seed(1)) * 30 - 10


def places(lattice: Lattice, spacing: float) -> torch.Tensor:
    """Places of the nodes [mm]."""
    axes = [torch.arange(n) * spacing for n in lattice.shape]
    return torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1).reshape(-1, 3) + POINTS.min(dim=0).values


def test_linear_fields_are_exact_between_nodes():
    lattice = Lattice.around(POINTS, 7.0)
    matrix = torch.tensor([[0.1, -0.2, 0.3], [0.0, 0.5, 0.1], [0.7, 0.0, -0.4]])
    found = lattice.at_gaussians(places(lattice, 7.0) @ matrix.T + 1.5)
    torch.testing.assert_close(found, POINTS @ matrix.T + 1.5, atol=1e-5, rtol=1e-5)


def test_sums_at_nodes_are_the_adjoint():
    lattice = Lattice.around(POINTS, 5.0)
    nodes, values = torch.randn(lattice.nodes, 3), torch.randn(40, 3)
    left, right = (lattice.at_gaussians(nodes) * values).sum(), (nodes * lattice.to_nodes(values)).sum()
    assert float(left) == pytest.approx(float(right), rel=1e-5)


def test_smoothing_keeps_constants_and_levels_a_peak():
    lattice = Lattice.around(POINTS, 5.0)
    torch.testing.assert_close(
        lattice.smoothed(torch.full((lattice.nodes, 3), 2.0)), torch.full((lattice.nodes, 3), 2.0)
    )
    peak = torch.zeros(lattice.nodes, 3)
    peak[lattice.nodes // 2] = 6.0
    assert float(lattice.smoothed(peak).max()) <= 2.0


def test_phases_begin_as_the_shared_model():
    shared = Gaussians(POINTS, torch.zeros(40, 3), torch.eye(4)[0].repeat(40, 1), torch.rand(40, 2), ("a", "b"))
    phases = PhaseGaussians.begin(shared, shared.coefficients.detach().expand(3, -1, -1).clone(), 6.0)
    assert len(phases) == 3
    for phase in range(3):
        for name, values in phases.at(phase).tensors().items():
            torch.testing.assert_close(values, shared.tensors()[name])
