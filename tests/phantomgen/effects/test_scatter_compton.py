"""Compton scatter of scans: a small object against one electron's formula, a ball against a Monte Carlo of its own."""

from dataclasses import replace

import numpy as np
import pytest

from phantomgen.effects import Aperture, ComptonScatter
from phantomgen.effects.random_streams import Stream
from phantomgen.effects.scatter import scatterers
from phantomgen.effects.smooth_signal import spline_weights
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.scene.scan import Scan, load_scene
from phantomgen.simulation.forward_model.discretization import Settings
from phantomgen.simulation.forward_model.exposure import Exposure
from phantomgen.simulation.forward_model.frames import Views
from phantomgen.simulation.forward_model.scatter import SingleScatter
from spectra.basis.basis import klein_nishina
from spectra.detector.scintillator import EnergyIntegrating, absorbed
from spectra.errors import SceneError
from spectra.materials.electron_density import ELECTRON_RADIUS, electron_density

ENERGY, PHOTONS, PIXELS, PITCH, SOD, SDD = 100.0, 1e6, 16, 20.0, 500.0, 800.0
REST = 510.99895
TINY = ["geometry.views=2", "geometry.test_views=0", "panel.rows=8", "panel.columns=8", "panel.pitch=25.6"]


def ball(
    radius: float, compton: float, thresholds: list[float], center: tuple[float, ...] = (0, 0, 0), panel: str = ""
) -> Scan:
    """A ball that only scatters, in monochromatic light, before a perfect sensor."""
    return load_scene(
        "kedge-small",
        [
            f"source={{type: monochromatic, energy: {ENERGY}, photons: {PHOTONS}}}",
            f"detector={{type: photon_counting, composition: Pb, thickness: 100, thresholds: {thresholds}}}",
            "basis=[{type: photoelectric}, {type: compton}]",
            f"materials={{matter: {{coefficients: {{photoelectric: 0.0, compton: {compton}}}}}}}",
            f"objects=[{{type: sphere, material: matter, center: {list(center)}, radius: {radius}}}]",
            f"panel={{rows: {PIXELS}, columns: {PIXELS}, pitch: {PITCH}{panel}}}",
            "geometry.views=2",
            "geometry.test_views=0",
            f"volume={{voxels: 8, size: {2 * (radius + max(map(abs, center)))}}}",
            "effects.scatter={type: compton}",
        ],
    )


def single(scan: Scan, settings: Settings) -> np.ndarray:
    exposure = Exposure.of(scan, np.array([[10.0]]), 1e-5)[0]
    return SingleScatter.of(scan, exposure, settings).view(0)


def angles_and_pixels(place: tuple[float, ...] = (0, 0, 0), bend: float = np.inf) -> tuple[np.ndarray, np.ndarray]:
    """Cosine of the angle of scatter at a place, and the solid angle of each pixel as seen from there."""
    across = (np.arange(PIXELS) - (PIXELS - 1) / 2) * PITCH
    turn = across / bend
    forward, side = (0.0 * turn, across) if np.isinf(bend) else (bend * (1 - np.cos(turn)), bend * np.sin(turn))
    pixel = np.stack(np.broadcast_arrays(SOD - SDD + forward, side, -across[:, None]), axis=2)
    normal = np.stack([-np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    inward, outward = np.array(place) - [SOD, 0, 0], pixel - place
    distance = np.linalg.norm(outward, axis=2)
    solid = PITCH**2 * np.einsum("rci,ci->rc", outward, normal) / distance**3
    return outward @ inward / distance / np.linalg.norm(inward), solid


@pytest.mark.parametrize(("center", "cells"), [((0.0, 0.0, 0.0), 4), ((60.0, -25.0, 40.0), 20)])
@pytest.mark.parametrize("bend", [np.inf, 300.0])
def test_a_small_object_scatters_what_its_electrons_do(center, cells, bend):
    radius, compton = 0.5, 1e-4
    panel = "" if np.isinf(bend) else f", curvature: {{radius: {bend}, module_columns: 1}}"
    scan = ball(radius, compton, [20.0], center, panel)
    electrons = electron_density(scan.scene.materials[0], scan.basis) * 4 / 3 * np.pi * radius**3
    cosine, solid = angles_and_pixels(center, bend)
    k = 1 / (1 + ENERGY / REST * (1 - cosine))
    section = ELECTRON_RADIUS**2 / 2 * k**2 * (k + 1 / k - 1 + cosine**2)
    per_steradian = PHOTONS / (PITCH**2 / SDD**2)
    wanted = per_steradian / ((SOD - center[0]) ** 2 + center[1] ** 2 + center[2] ** 2) * electrons * section * solid
    found = single(scan, Settings(scatter=(cells, 15)))
    np.testing.assert_allclose(found[0], wanted, rtol=1e-2)
    half = replace(scan, effects=replace(scan.effects, aperture=Aperture(0.5, 0.8)))
    np.testing.assert_allclose(single(half, Settings(scatter=(cells, 15))), 0.4 * found, rtol=1e-9)


def test_a_detector_that_sums_up_energies_measures_photons_that_have_lost_some():
    plain = ball(0.5, 1e-4, [20.0])
    detector = EnergyIntegrating.behind(plain.source, "CsI")
    scan = replace(plain, detector=detector)
    cosine, _ = angles_and_pixels()
    left = (ENERGY / (1 + ENERGY / REST * (1 - cosine))).ravel()
    assert left.min() < detector.lowest
    signal = left * absorbed(detector.material, detector.thickness, left)
    settings = Settings(scatter=(4, 15))
    found, counted = single(scan, settings)[0], single(plain, settings)[0]
    np.testing.assert_allclose(found, counted * signal.reshape(found.shape), rtol=1e-3)


def test_scattered_photons_are_counted_at_the_energy_that_is_left():
    limit = 98.0
    scan = ball(0.5, 1e-4, [20.0, limit])
    cosine, _ = angles_and_pixels()
    left = ENERGY / (1 + ENERGY / REST * (1 - cosine))
    low, high = single(scan, Settings(scatter=(2, 16)))
    clear = np.abs(left - limit) > 0.3
    is_low = low > high
    np.testing.assert_array_equal(is_low[clear], (left < limit)[clear])
    assert is_low.any()
    assert (~is_low).any()


def ball_chord(start: np.ndarray, direction: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Where lines along unit vectors enter and leave a ball around the origin."""
    along = -(start * direction).sum(axis=1)
    half = np.sqrt(np.clip(radius**2 - (start**2).sum(axis=1) + along**2, 0, None))
    return along - half, along + half


def monte_carlo(radius: float, compton: float, photons: int, regions: int) -> tuple[np.ndarray, np.ndarray]:
    """Scattered photons per region of the panel and their standard error: source, free path, angle, energy, exit.

    No direction with a cosine below 0.6 to the central ray leads from the ball to the panel.
    """
    rng = np.random.default_rng(2)
    least = SOD / np.hypot(SOD, radius) * np.sqrt(1 + (radius / SOD) ** 2) * np.sqrt(1 - (radius / SOD) ** 2)
    c, turn = rng.uniform(least, 1, photons), rng.uniform(0, 2 * np.pi, photons)
    s = np.sqrt(1 - c**2)
    inward = np.stack([-c, s * np.cos(turn), s * np.sin(turn)], axis=1)
    source = np.tile([SOD, 0.0, 0.0], (photons, 1))
    enter, leave = ball_chord(source, inward, radius)
    mu = compton * klein_nishina(np.array([ENERGY]))[0] / klein_nishina(np.array([70.0]))[0]
    chance = -np.expm1(-mu * (leave - enter))
    place = source + (enter - np.log1p(-rng.random(photons) * chance) / mu)[:, None] * inward
    c2, turn2 = rng.uniform(0.6, 1, photons), rng.uniform(0, 2 * np.pi, photons)
    s2 = np.sqrt(1 - c2**2)
    outward = np.stack([-c2, s2 * np.cos(turn2), s2 * np.sin(turn2)], axis=1)
    cosine = (inward * outward).sum(axis=1)
    k = 1 / (1 + ENERGY / REST * (1 - cosine))
    density = k**2 * (k + 1 / k - 1 + cosine**2) / 2 / (2 * np.pi * klein_nishina(np.array([ENERGY]))[0])
    left = compton * klein_nishina(k * ENERGY) / klein_nishina(np.array([70.0]))[0]
    weight = chance * density * 2 * np.pi * 0.4 * np.exp(-left * ball_chord(place, outward, radius)[1])
    away = (place[:, 0] + SDD - SOD) / np.where(outward[:, 0] < 0, -outward[:, 0], np.inf)
    hit = (place + away[:, None] * outward)[:, 1:] / (PITCH * PIXELS) + 0.5
    weight *= (outward[:, 0] < 0) & (hit > 0).all(axis=1) & (hit < 1).all(axis=1)
    region = (np.clip(hit, 0, 1 - 1e-9) * regions).astype(int) @ [1, regions]
    sums, squares = (np.bincount(region, w, regions**2) for w in (weight, weight**2))
    scale = PHOTONS / (PITCH**2 / SDD**2) * 2 * np.pi * (1 - least) / photons
    return scale * sums.reshape(regions, regions), scale * np.sqrt(squares).reshape(regions, regions)


def test_a_ball_that_weakens_what_it_scatters_agrees_with_a_monte_carlo():
    radius, compton, regions = 60.0, 0.02, 4
    wanted, error = monte_carlo(radius, compton, 400_000, regions)
    found = single(ball(radius, compton, [20.0]), Settings(scatter=(14, 7)))[0]
    size = PIXELS // regions
    found = found.reshape(regions, size, regions, size).sum(axis=(1, 3))
    assert np.sqrt((error**2).sum()) < 0.005 * wanted.sum()
    np.testing.assert_allclose(found, wanted, atol=5 * error.max(), rtol=0.0)
    assert found.sum() == pytest.approx(wanted.sum(), rel=0.02)


def test_what_lies_outside_the_beam_does_not_scatter():
    assert single(ball(5.0, 0.01, [20.0], (0.0, 0.0, 150.0)), Settings(scatter=(8, 4))).max() == 0.0


def test_views_hold_scatter_and_flats_do_not():
    scan = ball(30.0, 0.02, [20.0, 60.0])
    none = replace(scan, effects=replace(scan.effects, scatter=None))
    exposure = Exposure.of(scan, np.array([[60.0]]), 1e-5)[0]
    with_scatter, without = (Views(s, exposure) for s in (scan, none))
    added = with_scatter.expected(1) - without.expected(1)
    assert added[1].min() > 0
    np.testing.assert_allclose(added, with_scatter.scatter(1, added), rtol=1e-6)
    np.testing.assert_array_equal(*(v.expected(0, Stream.FLAT) for v in (with_scatter, without)))
    np.testing.assert_array_equal(with_scatter.expected(1), Views(scan, exposure).expected(1))


def test_each_of_several_sources_scatters_into_its_own_channels_as_it_does_alone():
    sources = {name: f"{{type: monochromatic, energy: {e}, photons: 1e6}}" for name, e in (("a", 60), ("b", 100))}
    both = f"{{type: multi_source, sources: {{a: {sources['a']}, b: {sources['b']}}}}}"
    found = []
    for source in (both, sources["a"], sources["b"]):
        changed = [f"source={source}", "detector={type: energy_integrating, composition: CsI}", *TINY]
        scan = load_scene("kedge-small", [*changed, "effects.scatter={type: compton}"])
        exposure = Exposure.of(scan, np.array([[60.0, 10.0, 10.0, 10.0]]), 1e-5)[0]
        found.append(SingleScatter.of(scan, exposure, Settings(scatter=(6, 5))).view(0))
    assert found[0].min() > 0
    np.testing.assert_allclose(found[0], np.concatenate(found[1:]), rtol=1e-6)


def test_scatterers_hold_all_and_lie_where_it_is():
    grid, rng = Grid.cube(12, 24.0), np.random.default_rng(0)
    density = np.zeros((12, 12, 12))
    density[2:7, 1, 4:9] = rng.random((5, 5))
    place, held = scatterers(density, grid, 3, np.random.RandomState(1))
    assert held.sum() == pytest.approx(density.sum() * grid.voxel_volume)
    zyx = np.rint((place[:, ::-1] - grid.origin) / grid.spacing).astype(int)
    assert (density[tuple(zyx.T)] > 0).all()


def test_splines_are_exact_for_cubics():
    x = np.arange(20.0)
    places = np.linspace(-0.5, 19.5, 7)
    np.testing.assert_allclose(spline_weights(20, 7) @ (places**3 - 5 * places), x**3 - 5 * x, rtol=1e-9, atol=1e-9)


def test_a_scene_asks_for_it():
    assert ball(1.0, 0.01, [20.0]).effects.scatter == ComptonScatter()
    with pytest.raises(SceneError, match=r"effects\.scatter"):
        load_scene("kedge-small", ["effects.scatter={type: compton, ratio: 1}"])
