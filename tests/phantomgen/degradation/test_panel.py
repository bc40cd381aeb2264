"""Images and masks of a panel with fewer or larger pixels."""

import numpy as np
import pytest

from phantomgen.degradation.panel import (
    binned_mask,
    binned_mean,
    binned_sum,
    check_bin,
    columns_left,
)
from spectra.errors import InputError


def test_binning_sums_counts_and_joins_masks():
    image = np.arange(24).reshape(4, 6)
    assert binned_sum(image, 2).tolist() == [[14, 22, 30], [62, 70, 78]]
    assert binned_sum(image, 2).sum() == image.sum()
    assert binned_mean(image.astype(float), 2)[0, 0] == 3.5
    mask = np.zeros((4, 6), np.uint32)
    mask[0, 0], mask[1, 1], mask[3, 5] = 2, 64, 8
    assert binned_mask(mask, 2).tolist() == [[66, 0, 0], [0, 0, 8]]


def test_columns_are_cut_off_on_both_sides_alike():
    assert columns_left(128, 0.2) == slice(13, 115)
    assert columns_left(128, 0.0) == slice(0, 128)
    with pytest.raises(InputError, match="leaves none"):
        columns_left(4, 0.9)


def test_a_number_that_does_not_divide_the_panel_is_refused_with_those_that_do():
    with pytest.raises(InputError, match=r"6 x 12 pixels cannot be binned by 4: 2, 3, 6 would"):
        check_bin(6, 12, 4)
    with pytest.raises(InputError, match="no other number would"):
        check_bin(7, 12, 2)
