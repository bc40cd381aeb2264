import numpy as np
import pytest
from support.gaussian_scenes import circular, tilted
from support.orbit_scenes import FILTERED, GRID, blobs, relative_error
from support.tolerances import TOLERANCES

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from recon.voxel.filtered.fdk import Fdk, fdk
from recon.voxel.filtered.ramp_filter import WINDOWS, ramp_filtered
from spectra.errors import GeometryError, InputError

MIDDLE = np.s_[:, 8:16]  # near the plane of the orbit, where the method is exact


@pytest.mark.parametrize("window", ["ram-lak", "hann"])
def test_gaussians_come_back_with_their_absolute_scale(window):
    geometry = Geometry.circular(500, 800, 2 * np.pi / 120 * np.arange(120), Panel(40, 48, 1.6))
    truth = blobs(sigma=4.0)
    volume = fdk(truth.line_integrals(geometry).numpy(), geometry, GRID, window)
    expected = truth.volume(GRID)
    for found, right in zip(volume[MIDDLE], expected[MIDDLE], strict=True):
        scale = (found * right).sum() / (right**2).sum()
        assert scale == pytest.approx(1, abs=TOLERANCES["fdk_scale"])
        assert abs(found - right).max() < 2 * TOLERANCES["fdk_scale"] * right.max()


@pytest.fixture(scope="module")
def full():
    """Truth, and the error of a full circle with the panel of the other orbits."""
    truth, geometry = blobs(), FILTERED["full circle"]
    expected = truth.volume(GRID)
    return truth, expected, relative_error(_sharp(truth, geometry)[MIDDLE], expected[MIDDLE])


def _sharp(truth, geometry):
    return fdk(truth.line_integrals(geometry).numpy(), geometry, GRID, "ram-lak")


@pytest.mark.parametrize("name", FILTERED)
def test_every_circular_orbit_gives_the_volume_of_a_full_circle(name, full):
    """Half-fans, arcs, tilts and parallel beams, without a shift, a step at the axis, or a wrong scale."""
    truth, expected, error = full
    volume = _sharp(truth, FILTERED[name])
    assert relative_error(volume[MIDDLE], expected[MIDDLE]) < error + TOLERANCES["fdk_other_orbits"]
    assert (volume[MIDDLE] * expected[MIDDLE]).sum() / (expected[MIDDLE] ** 2).sum() == pytest.approx(1, abs=0.025)


def test_weights_matter_on_a_half_fan_and_a_short_scan(full):
    """The same data, taken for a full circle, are wrong by far more than the tolerance above."""
    truth, expected, error = full
    for name in ("half-fan", "short scan"):
        geometry = FILTERED[name]
        unweighted = 2 * _sharp(truth, geometry)
        assert relative_error(unweighted[MIDDLE], expected[MIDDLE]) > error + 5 * TOLERANCES["fdk_other_orbits"]


@pytest.mark.parametrize("window", WINDOWS)
def test_windows_follow_their_formulas(window):
    """The filtered unit pulse has the ramp times the window as its spectrum."""
    pulse = np.zeros((1, 1, 1, 513), np.float32)
    pulse[..., 256] = 1
    found = np.abs(np.fft.rfft(ramp_filtered(pulse, 1.0, window, 1.0)[0, 0, 0], 4096))
    f = np.arange(2049) / 2048
    formulas = {
        "ram-lak": np.ones_like(f),
        "shepp-logan": np.sin(np.pi * f / 2) / np.maximum(np.pi * f / 2, 1e-12),
        "cosine": np.cos(np.pi * f / 2),
        "hann": np.cos(np.pi * f / 2) ** 2,
    }
    np.testing.assert_allclose(found, f / 4 * formulas[window], atol=1.5e-3)
    half = np.abs(np.fft.rfft(ramp_filtered(pulse, 1.0, window, 0.5)[0, 0, 0], 4096))
    assert (half[f > 0.55] ** 2).sum() < 1e-3 * (half**2).sum()


@pytest.mark.parametrize(("window", "cutoff"), [("box", 1.0), ("hann", 0.0)])
def test_unknown_filters_are_refused(window, cutoff):
    geometry = FILTERED["full circle"]
    with pytest.raises(InputError, match="ram-lak, shepp-logan, cosine, hann"):
        fdk(np.zeros((len(geometry), 1, 40, 48), np.float32), geometry, GRID, window, cutoff)


def test_the_method_is_the_function():
    geometry, truth = FILTERED["full circle"], blobs()
    images, told = truth.line_integrals(geometry).numpy(), []
    volumes = Fdk("cosine", 0.9).reconstruct(np.moveaxis(images, 1, 0), None, geometry, GRID, told.append)
    np.testing.assert_array_equal(volumes, fdk(images, geometry, GRID, "cosine", 0.9))
    assert [(i.done, i.total) for i in told] == [(1, 1)]


def test_a_shift_of_the_object_shifts_the_volume():
    """No half-voxel or half-pixel offset: the centre of mass is where the Gaussian is."""
    geometry = Geometry.circular(500, 800, 2 * np.pi / 60 * np.arange(60), Panel(40, 48, 1.6))
    centre = [2.3, -1.7, 0.6]
    volume = fdk(blobs([centre], 3.0).line_integrals(geometry).numpy(), geometry, GRID)[0]
    weights = np.where(volume > 0.1 * volume.max(), volume, 0)
    z, y, x = np.meshgrid(*(GRID.axis(name) for name in "zyx"), indexing="ij")
    found = [(weights * axis).sum() / weights.sum() for axis in (x, y, z)]
    np.testing.assert_allclose(found, centre, atol=0.05)


@pytest.mark.parametrize("geometry", [tilted(), circular(views=1)], ids=["free", "one view"])
def test_other_orbits_are_refused(geometry):
    images = np.zeros((len(geometry), 1, geometry.panel.rows, geometry.panel.columns), np.float32)
    with pytest.raises(GeometryError, match="needs at least two evenly spaced views on a full circle"):
        fdk(images, geometry, GRID)
