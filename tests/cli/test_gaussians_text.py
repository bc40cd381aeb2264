"""How the summary of a fit states the size of its model."""

import pytest

from recon.cli.common import gaussians_text


@pytest.mark.parametrize(("part", "words"), [(1.1, "110 %"), (0.072, "7.2 %"), (0.0031, "0.3 %")])
def test_numbers_are_stated_beside_those_of_voxels(part, words):
    said = gaussians_text({"gaussians": 12, "numbers": 156, "numbers_over_voxels": part})
    assert said == f"12 Gaussians (156 numbers, {words} of those of voxels)"


def test_a_model_without_a_count_is_named_alone():
    assert gaussians_text({"gaussians": 12}) == "12 Gaussians"
