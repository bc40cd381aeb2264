"""Lists of boxes per tile, against a look at every pair."""

import itertools

import torch
from hypothesis import given
from hypothesis import strategies as st

from recon.ops.tile_lists import tile_lists

END = st.integers(0, 13)


@given(
    bounds=st.integers(1, 3).flatmap(
        lambda axes: st.lists(st.lists(END, min_size=2 * axes, max_size=2 * axes), min_size=1, max_size=7)
    ),
    edges=st.tuples(*3 * [st.integers(1, 5)]),
)
def test_every_tile_names_the_boxes_that_reach_into_it_in_their_order(bounds, edges):
    axes = len(bounds[0]) // 2
    tile = edges[:axes]
    tiles = tuple(-(-13 // edge) for edge in tile)
    member, starts = tile_lists(torch.tensor(bounds), tile, tiles)
    found = [member[a:b].tolist() for a, b in itertools.pairwise(starts.tolist())]
    expected = []
    for place in itertools.product(*map(range, tiles)):
        inside = [(p * edge, (p + 1) * edge) for p, edge in zip(place, tile, strict=True)]
        expected.append([g for g, box in enumerate(bounds) if _meet(box, inside)])
    assert found == expected


def _meet(box, tile):
    """Whether there is an index along every axis that lies in both."""
    return all(max(box[2 * i], a) < min(box[2 * i + 1], b) for i, (a, b) in enumerate(tile))
