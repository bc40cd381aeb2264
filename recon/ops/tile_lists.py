"""Lists of the boxes that reach into each tile, so that one GPU program adds up one tile without atomics."""

import torch
from jaxtyping import Int64
from torch import Tensor


def tile_lists(
    bounds: Int64[Tensor, "box two_per_axis"], tile: tuple[int, ...], tiles: tuple[int, ...]
) -> tuple[Int64[Tensor, " member"], Int64[Tensor, " tile_plus_1"]]:
    """List the boxes of each tile in their order, one tile after the other.

    Parameters
    ----------
    bounds : first index and one past the last along each axis; an empty box is in no list
    tile : edges of a tile
    tiles : number of tiles along each axis; the last axis counts fastest

    Returns
    -------
    numbers of the boxes, and where the list of each tile starts
    """
    low, high = bounds[:, ::2], bounds[:, 1::2]
    edge = torch.tensor(tile, device=bounds.device)
    first = low // edge
    extent = ((high + edge - 1) // edge - first).clamp(min=0)
    counts = torch.where((high > low).all(1), extent.prod(1), 0)
    member = torch.repeat_interleave(torch.arange(len(bounds), device=bounds.device), counts)
    rest = torch.arange(len(member), device=bounds.device) - (counts.cumsum(0) - counts)[member]
    number, stride = torch.zeros_like(member), 1
    for axis in reversed(range(len(tile))):
        number += stride * (first[member, axis] + rest % extent[member, axis])
        rest = rest // extent[member, axis]
        stride *= tiles[axis]
    number, order = torch.sort(number, stable=True)
    starts = torch.searchsorted(number, torch.arange(stride + 1, device=bounds.device))
    return member[order], starts
