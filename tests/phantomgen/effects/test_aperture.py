"""Sensitive parts of pixels: closed forms at an edge, agreement with plain grids of rays, and counts that are lost."""

from dataclasses import replace

import numpy as np
import pytest

from phantomgen.effects import Aperture
from phantomgen.effects.random_streams import Stream
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.ops.expected_counts import (
    CROSSED,
    NEAR,
    SMOOTH,
    Sampling,
    Spectrum,
    expected_counts,
    expected_counts_by_grid,
)
from phantomgen.scene.scan import load_scene
from phantomgen.shapes import Box, Cylinder, Sphere, solids_of
from phantomgen.simulation.forward_model.exposure import Exposure
from phantomgen.simulation.forward_model.frames import Views
from spectra.errors import InputError, SceneError

SOD, SDD, PITCH, PIXELS = 500.0, 800.0, 1.6, 32
SPECTRUM = Spectrum(np.array([[0.02], [0.06], [1e6]]), np.array([1.0]), np.array([0, 1]))
FRAME = Geometry.circular(SOD, SDD, np.array([0.3]), Panel(PIXELS, PIXELS, PITCH)).ray_frames()[0]
STRAIGHT = Geometry.circular(SOD, SDD, np.zeros(1), Panel(PIXELS, PIXELS, PITCH)).ray_frames()[0]


@pytest.mark.parametrize("place", [-0.43, -0.2, 0.0, 0.1, 0.31, 0.49])
@pytest.mark.parametrize("part", [0.25, 0.6, 1.0])
def test_an_opaque_edge_covers_as_much_of_the_aperture_as_it_should(place, part):
    """The shadow of a thin screen ends `place` pixels right of a centre."""
    edge = (0.5 + place) * PITCH * SOD / SDD
    screen = Box((0.0, edge - 1000.0, 0.0), (1e-3, 2000.0, 2000.0))
    seen = expected_counts(
        STRAIGHT, PIXELS, PIXELS, solids_of([(screen, 2)]), SPECTRUM, sampling=Sampling(aperture=(part, 0.5))
    ).counts[0]
    open_part = np.clip((part / 2 - place) / part, 0, 1)
    np.testing.assert_allclose(seen[PIXELS // 2, PIXELS // 2], open_part, atol=2e-4)


OBJECTS = [(Cylinder((0, 0, 0), 11, 24), 0), (Sphere((2, -3, 1), 4), 1)]


@pytest.mark.parametrize("aperture", [(0.5, 0.8), (0.9, 0.3), (1.0, 0.6)])
def test_all_classes_of_pixels_agree_with_a_plain_grid(aperture):
    solids = solids_of(OBJECTS)
    found = expected_counts(FRAME, PIXELS, PIXELS, solids, SPECTRUM, sampling=Sampling(aperture=aperture))
    rng = np.random.default_rng(1)
    for kind in (SMOOTH, NEAR, CROSSED):
        pixels = np.argwhere(found.classes == kind)
        pixels = pixels[rng.permutation(len(pixels))[:25]]
        exact = expected_counts_by_grid(FRAME, pixels, solids, SPECTRUM, n=192, aperture=aperture)
        error = np.abs(np.log(found.counts[:, pixels[:, 0], pixels[:, 1]].T / exact))
        assert len(pixels) > 10
        assert error.max() < 1e-4
        if kind == CROSSED:
            whole = expected_counts_by_grid(FRAME, pixels, solids, SPECTRUM, n=64)
            assert np.abs(np.log(whole / exact)).max() > 0.01


def test_a_whole_aperture_changes_no_bit():
    solids = solids_of(OBJECTS)
    plain, whole = (
        expected_counts(FRAME, PIXELS, PIXELS, solids, SPECTRUM, sampling=s)
        for s in (Sampling(), Sampling(aperture=(1.0, 1.0)))
    )
    np.testing.assert_array_equal(plain.counts, whole.counts)
    np.testing.assert_array_equal(plain.rays, whole.rays)


@pytest.mark.parametrize("part", [0.0, -0.5, 1.01])
def test_impossible_apertures_are_refused(part):
    with pytest.raises(InputError, match="at most 1 pixel"):
        Aperture(part, 0.5)


def test_photons_beside_the_aperture_are_lost_in_flats_too():
    tiny = ["geometry.views=2", "geometry.test_views=0", "panel.rows=8", "panel.columns=8", "panel.pitch=25.6"]
    scan = load_scene("kedge-small", [*tiny, "source={type: monochromatic, energy: 90, photons: 1e5}"])
    half = replace(scan, effects=replace(scan.effects, aperture=Aperture(0.8, 0.5)))
    whole, part = (Views(one, Exposure.of(one, np.array([[100.0, 20, 20, 20]]), 1e-5)[0]) for one in (scan, half))
    np.testing.assert_allclose(part.expected(0, Stream.FLAT), 0.4 * whole.expected(0, Stream.FLAT), rtol=1e-12)
    ratio = part.expected(1)[-1] / whole.expected(1)[-1]
    assert np.median(ratio) == pytest.approx(0.4, rel=1e-2)
    assert np.abs(ratio - 0.4).max() > 1e-3


def test_a_scene_names_what_is_wrong():
    assert load_scene("kedge-small", ["effects.aperture.width=0.9"]).effects.aperture == Aperture(0.9, 0.9)
    with pytest.raises(SceneError, match=r"effects\.aperture\.width"):
        load_scene("kedge-small", ["effects.aperture.width=1.2"])
