import numpy as np
import pytest

from recon.data.volume_edges import contrast_around, occupied_voxels


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_contrast_is_that_of_the_voxels_beside_a_face(axis):
    density = np.full((9, 9, 9), 0.02, np.float32)
    inside = tuple(slice(None, 5) if a == axis else slice(None) for a in range(3))
    density[inside] = 0.03
    volumes = np.stack([0.25 * density, 0.75 * density])
    found = np.moveaxis(contrast_around(volumes), axis, 0)
    beside, typical = found[4:6], np.median(density)
    np.testing.assert_allclose(beside, 0.01 / typical, rtol=0.1)
    assert not found[:4].any()
    assert not found[6:].any()


def test_even_and_empty_volumes_have_no_contrast():
    for value in (0.0, 0.02):
        assert not contrast_around(np.full((2, 5, 5, 5), value, np.float32)).any()


@pytest.mark.parametrize("metal", [0.02, 0.5, 5.0])
def test_a_body_is_occupied_beside_any_metal(metal):
    volumes = np.zeros((2, 12, 12, 12), np.float32)
    volumes[:, 2:10, 2:10, 2:10] = 0.02
    volumes[:, 5, 5, 5] = metal
    assert occupied_voxels(volumes).sum() == 8**3
    assert not occupied_voxels(np.zeros_like(volumes)).any()
