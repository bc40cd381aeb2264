"""Holes in projections: inpainted from around, exactly where images are linear."""

import numpy as np
import pytest

from phantomgen.dataset.inpainting import inpainted

ROW, COLUMN = np.mgrid[:9, :12].astype(float)
PLANES = np.stack([3 + 0.5 * ROW - 0.2 * COLUMN, ROW * COLUMN])


def hole(*where):
    unseen = np.zeros(ROW.shape, bool)
    for part in where:
        unseen[part] = True
    return unseen


HOLES = {
    "pixel": hole(np.s_[4, 5]),
    "block": hole(np.s_[3:6, 4:8]),
    "row": hole(np.s_[4]),
    "column": hole(np.s_[:, 5]),
    "row and column": hole(np.s_[4], np.s_[:, 5]),
    "rows and columns": hole(np.s_[3:5], np.s_[:, 5:7]),
}


@pytest.mark.parametrize("name", HOLES)
def test_images_that_are_linear_along_both_axes_come_back(name):
    unseen = HOLES[name]
    spoilt = np.where(unseen, np.nan, PLANES)
    np.testing.assert_allclose(inpainted(spoilt, unseen), PLANES, atol=1e-12)


def test_seen_pixels_stay_as_they_are_bit_by_bit():
    images = np.random.default_rng(0).normal(size=(2, 3, *ROW.shape)).astype(np.float32)
    found = inpainted(images, HOLES["block"])
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found[..., ~HOLES["block"]], images[..., ~HOLES["block"]])
    assert inpainted(images, hole()) is images
    assert inpainted(images, ~hole()) is images


def test_beyond_the_last_seen_pixel_its_value_goes_on():
    unseen = hole(np.s_[:, 9:], np.s_[:2])
    found = inpainted(np.where(unseen, np.nan, PLANES[0]), unseen)
    np.testing.assert_allclose(found[5, 9:], PLANES[0, 5, 8])
    np.testing.assert_allclose(found[:2, 3], PLANES[0, 2, 3])
    assert np.isfinite(found).all()
