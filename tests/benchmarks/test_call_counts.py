"""Calls between files: who calls whom, and which calls climb the layers of the import contracts."""

import pytest

from benchmarks.call_counts import is_climb, layers, report, trace
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.runtime.stopwatch import Stopwatch
from recon.cli.common import ProgressBar
from recon.voxel.model import Voxels


@pytest.mark.parametrize(
    ("pair", "expected"),
    [
        (("phantomgen.runtime.stopwatch", "recon.cli.common"), True),
        (("recon.cli.fit", "recon.runs.run"), False),
        (("recon.gaussians.optimize", "recon.gaussians.reconstruct"), True),
        (("recon.gaussians.reconstruct", "recon.gaussians.optimize"), False),
        (("recon.ops.rasterize", "recon.ops.rasterize.cpu_calls"), False),
        (("recon.ops.rasterize.cpu_calls", "recon.ops.rasterize"), True),
        (("recon.runs.checks", "recon.runs.methods"), False),  # beside each other
    ],
)
def test_a_call_from_a_lower_layer_to_a_higher_one_is_a_climb(pair, expected):
    assert is_climb(pair, layers()) is expected


def test_a_callback_is_one_climb_however_often_it_is_called():
    def work():
        clock = Stopwatch(ProgressBar(quiet=True).stage)
        for name in ("read", "fit"):
            with clock(name):
                pass

    calls = trace(work, None)
    assert [pair for pair in calls.pairs if is_climb(pair, layers())] == [
        ("phantomgen.runtime.stopwatch", "recon.cli.common")
    ]
    assert report(calls, listed=False) == [
        "all calls: 2 files, 1 pairs, 1 climbs, 0 of spectra.threads",
        "path of the counts or the scan: 0 files, 0 pairs, 0 climbs, 0 of spectra.threads",
    ]


def test_calls_are_followed_through_other_libraries():
    import numpy as np

    voxels = Voxels(np.ones((1, 2, 2, 2), np.float32), Grid.cube(2, 1.0), ("compton",))
    calls = trace(lambda: list(map(voxels.volume, [Grid.cube(3, 1.0)])), None)
    assert ("recon.voxel.model", "phantomgen.geometry.voxel_grid") in calls.pairs
