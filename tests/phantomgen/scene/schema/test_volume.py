"""Voxels that a scene asks for."""

import numpy as np
import pytest
from pydantic import ValidationError

from phantomgen.geometry.voxel_grid import Grid
from phantomgen.scene.schema import VolumeModel


@pytest.mark.parametrize(
    ("keys", "grid"),
    [
        ({"voxels": 64, "size": 128}, Grid.cube(64, 128)),
        ({"voxels": 4, "size": 8, "slices": 1}, Grid((1, 4, 4), (2, 2, 2), (0, -3, -3))),
        ({"voxels": 4, "size": 8, "center": [1, 2, 3]}, Grid((4, 4, 4), (2, 2, 2), (0, -1, -2))),
        ({"voxels": 4, "size": [8, 4, 2]}, Grid((1, 2, 4), (2, 2, 2), (0, -1, -3))),
        ({"voxels": [4, 2, 2], "size": [8, 4, 2]}, Grid((2, 2, 4), (1, 2, 2), (-0.5, -1, -3))),
        ({"voxels": 4, "size": 8, "slices": 2, "center": [0, 0, 5]}, Grid((2, 4, 4), (2, 2, 2), (4, -3, -3))),
    ],
)
def test_voxels_lie_about_the_center(keys: dict, grid: Grid) -> None:
    assert VolumeModel(**keys).grid == grid


@pytest.mark.parametrize("voxels", [1, 7, 100, 129])
def test_voxels_along_the_longest_edge_keep_edges_whole(voxels: int) -> None:
    edges = np.array([31.0, 17.0, 5.0])
    grid = VolumeModel(voxels=voxels, size=tuple(edges)).grid
    assert grid.shape[2] == voxels
    np.testing.assert_allclose(np.multiply(grid.shape, grid.spacing)[::-1], edges)
    if voxels >= 100:
        np.testing.assert_allclose(grid.spacing, edges[0] / voxels, rtol=0.05)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"voxels": [4, 4, 2], "size": 8}, "three numbers of voxels need a size of three edges"),
        ({"voxels": 4, "size": [8, 8, 4], "slices": 2}, "slices are those of a cube"),
        ({"voxels": [4, 0, 2], "size": [8, 8, 4]}, "greater than 0"),
        ({"voxels": 4, "size": [8, 8]}, "missing"),
    ],
)
def test_edges_that_do_not_go_together_are_refused(keys: dict, words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        VolumeModel(**keys)
