"""Scatter from a smooth kernel: what is scattered arrives, by a normal distribution, at the ratio asked for."""

import numpy as np
import pytest

from phantomgen.effects import ScatterKernel
from phantomgen.effects.focal_spot import FWHM
from phantomgen.effects.random_streams import Stream
from phantomgen.geometry.panel import Panel
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.forward_model.exposure import Exposure
from phantomgen.simulation.forward_model.frames import Views
from spectra.errors import InputError, SceneError


def slab(panel: Panel, projection: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Primary and open beam of two groups."""
    air = np.stack([np.full((panel.rows, panel.columns), level) for level in (1e4, 3e3)])
    return air * np.exp(-projection), air


def test_a_wide_slab_scatters_in_proportion_to_its_log_projection():
    panel, kernel = Panel(60, 80, 4.0), ScatterKernel(0.3, 30.0)
    for projection in (0.3, 1.0, 4.0):
        primary, air = slab(panel, np.full((1, 60, 80), projection))
        scattered = kernel.spread(primary, air, panel)
        middle = (slice(None), 30, 40)
        np.testing.assert_allclose(scattered[middle] / primary[middle], projection, rtol=1e-6)


@pytest.mark.parametrize("pitch", [(2.0, 2.0), (1.0, 3.0)])
def test_a_small_object_scatters_a_normal_distribution_and_nothing_is_lost(pitch):
    panel = Panel(161, 121, pitch)
    projection = np.zeros((1, 161, 121))
    projection[0, 78:83, 55:60] = 0.7
    primary, air = slab(panel, projection)
    scattered = ScatterKernel(1.0, 40.0).spread(primary, air, panel)
    sent = 25 * 0.7 * np.exp(-0.7) * air[:, 0, 0]
    np.testing.assert_allclose(scattered.sum(axis=(1, 2)), sent, rtol=2e-3)
    sigma = 40.0 / FWHM
    down, across = (
        np.exp(-((np.subtract.outer(np.arange(count), sent_from) * step / sigma) ** 2) / 2).mean(axis=1) * step
        for count, sent_from, step in ((161, range(78, 83), panel.row_pitch), (121, range(55, 60), panel.column_pitch))
    )
    wanted = sent[:, None, None] * np.outer(down, across) / (2 * np.pi * sigma**2)
    np.testing.assert_allclose(scattered, wanted, atol=0.01 * wanted.max())


def test_blocks_of_pixels_do_as_well_as_pixels():
    panel, rng = Panel(128, 128, 1.0), np.random.default_rng(3)
    projection = np.clip(np.add.outer(np.arange(128), np.arange(128)) / 100 + 0.2 * rng.random((128, 128)), 0, None)
    projection[:, :20] = 0.0
    primary, air = slab(panel, projection)
    blocks = ScatterKernel(1.0, 60.0).spread(primary, air, panel)
    sigma = 60.0 / FWHM
    near = np.exp(-(np.subtract.outer(np.arange(128), np.arange(128)) ** 2) / (2 * sigma**2))
    near /= np.sqrt(2 * np.pi) * sigma
    exact = near @ (-primary * np.log(primary / air)) @ near
    np.testing.assert_allclose(blocks, exact, atol=1e-3 * exact.max())


def test_scatter_over_primary_in_the_shadow_is_the_ratio():
    tiny = ["geometry.views=3", "geometry.test_views=0", "panel.rows=32", "panel.columns=32", "panel.pitch=6.4"]
    settings = [f"effects.scatter={{type: kernel, ratio: {ratio}, width: 60}}" for ratio in (0.0, 0.5)]
    scans = [load_scene("kedge-small", [*tiny, setting]) for setting in settings]
    exposure = Exposure.of(scans[0], np.array([[100.0, 20, 20, 20]]), 1e-5)[0]
    none, some = (Views(scan, exposure) for scan in scans)
    primary, both, air = none.expected(0), some.expected(0), none.expected(0, Stream.FLAT)
    shadow = primary.sum(axis=0) < 0.99 * air.sum(axis=0)
    assert (both - primary).min() > 0
    assert (both - primary).sum(axis=0)[shadow].sum() / primary.sum(axis=0)[shadow].sum() == pytest.approx(0.5)
    np.testing.assert_array_equal(some.expected(0, Stream.FLAT), air)
    turned = (some.expected(2) - none.expected(2)).sum() / none.expected(2).sum()
    assert turned == pytest.approx((both - primary).sum() / primary.sum(), rel=0.1)


def test_a_scene_names_what_is_wrong():
    with pytest.raises(InputError, match="ratio of scatter"):
        ScatterKernel(-1.0, 10.0)
    with pytest.raises(InputError, match="width of a scatter kernel"):
        ScatterKernel(1.0, 0.0)
    with pytest.raises(SceneError, match=r"effects\.scatter"):
        load_scene("kedge-small", ["effects.scatter={type: kernel, ratio: 0.5}"])
    with pytest.raises(SceneError, match=r"effects\.scatter"):
        load_scene("kedge-small", ["effects.scatter={type: kernle, ratio: 0.5}"])
