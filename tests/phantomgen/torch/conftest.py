"""Two small scans for the tests of this folder."""

import pytest
from support.tiny_scans import make


@pytest.fixture(scope="session")
def scan_paths(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scans")
    sizes = {"rows": 12, "columns": 16, "voxels": 8}
    return [
        make(folder / f"{seed}.h5", "--views", str(views), "--test-views", "1", "--seed", str(seed), **sizes)
        for seed, views in ((1, 4), (2, 3))
    ]
