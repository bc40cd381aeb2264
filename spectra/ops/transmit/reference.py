"""Expected counts as the formula reads, in float64 torch: the truth in tests, never used in production."""

from itertools import pairwise

import torch
from jaxtyping import Float64


def transmit(
    lengths: Float64[torch.Tensor, "ray basis"],
    columns: Float64[torch.Tensor, "basis node"],
    weights: Float64[torch.Tensor, " node"],
    starts: list[int],
) -> Float64[torch.Tensor, "ray channel"]:
    """Compute Y_c = sum over the nodes k of channel c of w_k exp(-sum_m B_mk L_m); gradients by autograd.

    Parameters
    ----------
    lengths : line integrals, (ray, M)
    columns : functions of energy at the nodes, (M, K)
    weights : photons x response of each node
    starts : first node of each channel, and the number of nodes

    Returns
    -------
    counts, (ray, C)
    """
    parts = weights * torch.exp(-lengths @ columns)
    return torch.stack([parts[:, a:b].sum(dim=1) for a, b in pairwise(starts)], dim=1)
