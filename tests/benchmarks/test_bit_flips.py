"""Random flips of single bits: `validate` notices each that changes what a dataset holds."""

import numpy as np
import pytest

from benchmarks.files.bit_flips import outcomes, write_scan

FLIPS = 25


@pytest.mark.parametrize("compression", ["gzip", "none"])
@pytest.mark.slow
def test_no_flipped_bit_that_matters_goes_unnoticed(compression, tmp_path):
    path = tmp_path / "scan.h5"
    write_scan(path, compression)
    bits = np.random.default_rng(1).integers(0, 8 * path.stat().st_size, FLIPS).tolist()
    found = list(outcomes(path, bits))
    assert found.count("noticed") > FLIPS / 5
    assert set(found) <= {"noticed", "harmless", "crash"}
    assert found.count("crash") <= 1  # in HDF5 itself
