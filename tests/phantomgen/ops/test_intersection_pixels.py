"""Pixels where surfaces intersect: against many rays, at the tolerance that is asked for."""

import numpy as np
import pytest

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.ops.expected_counts import (
    CROSSED,
    INTERSECTED,
    Sampling,
    Spectrum,
    expected_counts,
    expected_counts_by_grid,
)
from phantomgen.ops.solids import Solids
from phantomgen.shapes import Cylinder, HalfSpace, Intersection, Sphere, Union, solids_of
from spectra.errors import InputError
from spectra.threads import run_parallel, set_threads

SPECTRUM = Spectrum(np.array([[0.02, 0.03], [0.08, 0.2]]), np.array([1e4, 2e4]), np.array([0, 1, 2]))
BODY = (Sphere((0, 0, 0), 60.0), 0)
FIRST, SECOND = Cylinder((3, 2, 1), 14.0, 70.0, (0.3, 0.2, 1)), Cylinder((0, 0, 0), 10.0, 80.0, (1, 0.4, 0.1))
FRAME = Geometry.circular(500.0, 800.0, np.array([0.3]), Panel(48, 48, 4.0)).ray_frames()[0]


def worst_error(solids: Solids, kind: int, count: int, tolerance: float) -> float:
    found = expected_counts(FRAME, 48, 48, solids, SPECTRUM, sampling=Sampling(intersection_tolerance=tolerance))
    pixels = np.argwhere(found.classes == kind)
    pixels = pixels[:: max(1, len(pixels) // count)]
    brute = expected_counts_by_grid(FRAME, pixels, solids, SPECTRUM, n=256)
    return float(np.abs(np.log(found.counts[:, pixels[:, 0], pixels[:, 1]].T / brute)).max())


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize(
    "solids",
    [
        solids_of([BODY, (FIRST, 1), (SECOND, 0)]),
        solids_of([BODY, (Union((FIRST, SECOND)), 1)]),
        solids_of([BODY, (Intersection((Sphere((2, 3, 4), 28.0), HalfSpace((1, 0.5, 0.3), 5.0))), 1)]),
    ],
    ids=["two objects", "union", "cut sphere"],
)
def test_error_is_what_was_asked_for(solids: Solids, tolerance: float) -> None:
    assert worst_error(solids, INTERSECTED, 12, tolerance) < tolerance


def test_intersections_between_silhouettes_are_found() -> None:
    """Where a pixel has a silhouette and an intersection, Gauss nodes along the silhouette alone err by 1e-2."""
    solids = solids_of([BODY, (Union((FIRST, SECOND)), 1)])
    assert worst_error(solids, CROSSED, 60, 1e-4) < 3e-4


def test_more_silhouettes_than_can_be_split() -> None:
    crowd = [(Cylinder((0, 0, 0), 1.0 + 0.01 * i, 10.0), i % 2) for i in range(12)][::-1]
    frame, solids = Geometry.circular(500.0, 800.0, np.zeros(1), Panel(24, 24, 0.8)).ray_frames()[0], solids_of(crowd)
    found = expected_counts(frame, 24, 24, solids, SPECTRUM, sampling=Sampling(intersection_tolerance=1e-4))
    pixels = np.argwhere(found.classes == CROSSED)[::5]
    brute = expected_counts_by_grid(frame, pixels, solids, SPECTRUM, n=256)
    error = np.log(found.counts[:, pixels[:, 0], pixels[:, 1]].T / brute)
    assert np.abs(error).max() < 2e-4


def test_without_intersections_no_count_depends_on_the_tolerance() -> None:
    solids = solids_of([BODY, (Cylinder((5, 0, 0), 20.0, 40.0), 1), (Cylinder((5, 0, 0), 10.0, 30.0), 0)])
    coarse, fine = (
        expected_counts(FRAME, 48, 48, solids, SPECTRUM, sampling=Sampling(intersection_tolerance=t))
        for t in (1.0, 1e-6)
    )
    np.testing.assert_array_equal(coarse.counts, fine.counts)


def test_same_counts_whatever_the_threads() -> None:
    frames = Geometry.circular(500.0, 800.0, np.linspace(0, 3, 4), Panel(32, 32, 6.0)).ray_frames()
    solids, results = solids_of([BODY, (FIRST, 1), (SECOND, 0)]), []
    for threads in (1, 3):
        set_threads(threads)
        results.append(
            list(run_parallel(lambda frame: expected_counts(frame, 32, 32, solids, SPECTRUM).counts, frames))
        )
    set_threads(None)
    np.testing.assert_array_equal(results[0], results[1])


@pytest.mark.parametrize("tolerance", [0.0, -1.0, np.nan])
def test_refuses_a_tolerance_that_cannot_be_met(tolerance: float) -> None:
    with pytest.raises(InputError, match="must be positive"):
        expected_counts(FRAME, 4, 4, solids_of([BODY]), SPECTRUM, sampling=Sampling(intersection_tolerance=tolerance))
