"""Focal spots: where their points lie, and edges blurred by as much as similar triangles say."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr

from phantomgen.effects import FocalSpot
from phantomgen.effects.focal_spot import FWHM, LATTICES, spot_lattice
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.ops.expected_counts import Spectrum, expected_counts
from phantomgen.scene.scan import load_scene
from phantomgen.shapes import Box, solids_of
from phantomgen.simulation.checks.verification import SPOT_RAYS, quick_check
from phantomgen.simulation.forward_model.discretization import Settings
from phantomgen.simulation.forward_model.expected_counts import expected_view
from phantomgen.simulation.forward_model.exposure import Exposure
from spectra.errors import InputError, SceneError

SOD, SDD, PITCH = 500.0, 800.0, 0.5
GREY = Spectrum(np.array([[50.0]]), np.array([1.0]), np.array([0, 1]))


@pytest.mark.parametrize("n", list(LATTICES))
def test_lattices_are_midpoints_along_both_sides_and_look_alike_after_a_quarter_turn(n):
    points = spot_lattice(n)
    middles = (np.arange(n) - n // 2) / n
    for axis in (0, 1):
        np.testing.assert_allclose(np.sort(points[:, axis]), middles, atol=1e-15)
    turned = {(round(-y * n), round(x * n)) for x, y in points}
    assert turned == {(round(x * n), round(y * n)) for x, y in points}


@pytest.mark.parametrize(("shape", "deviation"), [("uniform", 1 / np.sqrt(12)), ("gaussian", 1 / FWHM)])
def test_spots_have_their_size(shape, deviation):
    offsets = FocalSpot(0.6, 1.5, shape).offsets(89)
    np.testing.assert_allclose(offsets.std(axis=0), np.array([0.6, 1.5]) * deviation, rtol=2e-4)
    np.testing.assert_allclose(offsets.mean(axis=0), 0.0, atol=1e-12)


def test_the_panel_stays_and_the_source_moves_along_it():
    frame = frame_of(8)
    frames = FocalSpot(0.6, 0.0).frames(frame, 5)
    np.testing.assert_allclose(frames[:, 0] + frames[:, 1], np.tile(frame[0] + frame[1], (5, 1)), atol=1e-12)
    moved = frames[:, 0] - frame[0]
    np.testing.assert_allclose(np.sort(moved[:, 1]), 0.6 * (np.arange(5) - 2) / 5, atol=1e-12)
    np.testing.assert_allclose(moved[:, [0, 2]], 0.0, atol=1e-12)


def frame_of(pixels: int) -> np.ndarray:
    geometry = Geometry.circular(SOD, SDD, np.zeros(1), Panel(pixels, pixels, PITCH))
    return geometry.ray_frames()[0]


def step_through_pixels(place: np.ndarray, blur: float, shape: str) -> np.ndarray:
    """Part of the spot that pixels see past an edge whose shadow falls on 0, from the definition, by many samples."""
    inside = (np.arange(2001) + 0.5) / 2001 - 0.5
    points = place[:, None] + inside * PITCH
    if shape == "gaussian":
        return ndtr(points / (blur / FWHM)).mean(axis=1)
    return np.clip(points / blur + 0.5, 0, 1).mean(axis=1)


@pytest.mark.parametrize(("shape", "tolerance"), [("uniform", 3e-4), ("gaussian", 4e-3)])
@pytest.mark.parametrize("upright", [True, False])
def test_an_edge_is_blurred_by_the_magnification_less_one_times_the_spot(shape, tolerance, upright):
    size, pixels, thin = 1.7, 16, 1e-3
    middle = (0.0, -2000.0, 0.0) if upright else (0.0, 0.0, -2000.0)
    screen = Box(middle, (thin, 4000.0, 4000.0))
    opaque = GREY._replace(attenuation=np.array([[1e6]]))
    spot = FocalSpot(size, 0.0, shape) if upright else FocalSpot(0.0, size, shape)
    frames = spot.frames(frame_of(pixels), 53)
    seen = np.mean(
        [expected_counts(f, pixels, pixels, solids_of([(screen, 0)]), opaque).counts[0] for f in frames], axis=0
    )
    profile = seen[pixels // 2] if upright else seen[::-1, pixels // 2]
    place = (np.arange(pixels) - (pixels - 1) / 2) * PITCH
    wanted = step_through_pixels(place, (SDD / SOD - 1) * size, shape)
    np.testing.assert_allclose(profile, wanted, atol=tolerance)


def test_more_blur_takes_more_points_up_to_a_limit():
    spot = FocalSpot(1.0, 1.0)
    counts = [spot.points_for(blur) for blur in (0.0, 0.3, 1, 2, 4, 100)]
    assert counts == [1, 5, 29, 53, 169, 233]
    assert FocalSpot(1.0, 1.0, "gaussian").points_for(1.0) == spot.points_for(2.0)
    assert spot.blur(frame_of(8), np.zeros((1, 3))) == pytest.approx((SDD / SOD - 1) / PITCH)


@pytest.mark.parametrize("size", [(-1.0, 1.0), (0.0, 0.0), (np.inf, 1.0), (600.0, 600.0)])
def test_impossible_spots_are_refused(size):
    with pytest.raises(InputError, match="needs a width or a height"):
        FocalSpot(*size)
    with pytest.raises(InputError, match="1 to 985 points"):
        FocalSpot(1.0, 1.0).offsets(1000)


SMALL = ["panel.rows=16", "panel.columns=32", "panel.pitch=6.4", "geometry.views=2", "geometry.test_views=0"]


def test_a_view_converges_with_points_and_a_tiny_spot_changes_nothing():
    sharp = load_scene("kedge-small", SMALL)
    transmission = Exposure.of(sharp, np.array([[100.0, 20, 20, 20]]), 1e-5)[0].groups
    tiny = replace(sharp, effects=replace(sharp.effects, focal_spot=FocalSpot(1e-6, 1e-6)))
    first, same = (expected_view(scan, transmission, 0, Settings()) for scan in (sharp, tiny))
    np.testing.assert_allclose(same, first, rtol=1e-6)
    wide = replace(sharp, effects=replace(sharp.effects, focal_spot=FocalSpot(8.0, 4.0)))
    exact, *views = (expected_view(wide, transmission, 0, Settings(spot=n)) for n in (169, 5, 29))
    errors = [np.abs(np.log(view / exact)).max() for view in views]
    assert errors[1] < min(2e-3, errors[0] / 4)
    assert np.abs(np.log(first / exact)).max() > 0.02


def test_the_error_that_is_measured_is_that_of_the_spot_too():
    line = "source={type: monochromatic, energy: 90, photons: 1e5}"
    scan = load_scene("kedge-small", [*SMALL, line, "effects.focal_spot.width=4", "effects.aperture.width=0.8"])
    transmission = Exposure.of(scan, np.array([[100.0, 20, 20, 20]]), 1e-5)[0].transmission
    found = quick_check(scan, transmission, Settings())
    assert found.sub_rays == SPOT_RAYS
    assert 0 < found.edge_worst < 3e-3
    sharp = replace(scan, effects=replace(scan.effects, focal_spot=None))
    assert quick_check(sharp, transmission, Settings()).edge_worst < 1e-4


def test_a_scene_has_a_spot_and_names_what_is_wrong_with_it():
    scan = load_scene("kedge-small", ["effects.focal_spot.width=0.6"])
    assert scan.effects.focal_spot == FocalSpot(0.6, 0.6)
    assert scan.source_fields["focal_spot"] == (0.6, "mm")
    with pytest.raises(SceneError, match=r"effects\.focal_spot.*needs a width"):
        load_scene("kedge-small", ["effects.focal_spot.width=0"])
