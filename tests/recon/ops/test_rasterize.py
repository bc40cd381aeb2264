import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from support.gaussian_scenes import (
    GEOMETRIES,
    PIXEL,
    REGIMES,
    circular,
    frames_of,
    one_gaussian,
    random_gaussians,
    tilted,
)
from support.tolerances import TOLERANCES

from recon.ops.rasterize import Projector, rasterize, reference
from spectra.errors import InputError
from spectra.threads import set_threads

NEARLY_UNCUT = 5.0  # the largest cutoff that the kernel's exponential allows


def largest_error(value, truth):
    return float((value - truth).abs().max() / truth.abs().max())


def rms_error(value, truth):
    return float(((value - truth).square().mean() / truth.square().mean()).sqrt())


def value_and_gradients(function, parts, seed=0):
    leaves = [part.clone().requires_grad_() for part in parts]
    value = function(*leaves)
    cotangent = torch.from_numpy(np.random.default_rng(seed).normal(size=value.shape))
    return value.detach(), torch.autograd.grad(value, leaves, cotangent)


@pytest.mark.parametrize("footprint", [0.0, 1.0])
@pytest.mark.parametrize("regime", REGIMES)
@pytest.mark.parametrize(("where", "bases"), [("odd-even", 3), ("even-odd", 1), ("tilted", 2)])
def test_kernel_gives_the_values_and_gradients_of_the_reference(where, bases, regime, footprint):
    geometry, parts = GEOMETRIES[where], random_gaussians(3, bases=bases, sigma=REGIMES[regime])
    view = (frames_of(geometry), geometry.panel.rows, geometry.panel.columns)
    projector = Projector(footprint, NEARLY_UNCUT)
    truth, gradients = value_and_gradients(lambda *p: reference.rasterize(*p, *view, footprint), parts)
    image, kernel_gradients = value_and_gradients(lambda *p: rasterize(*p, *view, projector), parts)
    assert largest_error(image, truth) < TOLERANCES["kernel_value"]
    for gradient, expected in zip(kernel_gradients, gradients, strict=True):
        assert rms_error(gradient, expected) < TOLERANCES["kernel_gradient"]


@pytest.mark.parametrize("footprint", [0.0, 1.0])
def test_gradients_of_the_reference_are_finite_differences(footprint):
    geometry = tilted(4, 5, views=1)
    parts = [part.requires_grad_() for part in random_gaussians(1, count=2, bases=2, sigma=(0.3, 1.5), spread=2.0)]
    assert torch.autograd.gradcheck(lambda *p: reference.rasterize(*p, frames_of(geometry), 4, 5, footprint), parts)


def quadrature(parts, frame, pixels):
    """Trapezoidal rule along rays, ten steps per smallest standard deviation, rotations by scipy."""
    centres, log_scales, quaternions, values = (part.numpy() for part in parts)
    turns = Rotation.from_quat(quaternions[:, [1, 2, 3, 0]]).as_matrix()
    whitening = np.exp(-log_scales)[:, :, None] * turns.transpose(0, 2, 1)
    source, first, column_step, row_step = frame
    directions = first + pixels[:, :1] * column_step + pixels[:, 1:] * row_step
    step = np.exp(log_scales.min()) / 10 / np.linalg.norm(directions, axis=1).max()
    t = np.arange(0.1, 1.1, step)
    out = []
    for d in directions:
        u = np.einsum("gij,gtj->gti", whitening, source + t[:, None] * d - centres[:, None])
        out.append(np.exp(-0.5 * (u * u).sum(-1)).sum(1) @ values * step * np.linalg.norm(d))
    return np.array(out)


@pytest.mark.parametrize("where", GEOMETRIES)
def test_line_integrals_equal_numerical_quadrature_along_rays(where):
    geometry, parts = GEOMETRIES[where], random_gaussians(8, sigma=(0.5, 2.5))
    rng, panel = np.random.default_rng(2), geometry.panel
    pixels = np.stack([rng.integers(0, panel.columns, 20), rng.integers(0, panel.rows, 20)], axis=1)
    expected = quadrature(parts, geometry.ray_frames()[-1], pixels)
    view = (frames_of(geometry)[-1:], panel.rows, panel.columns)
    truth = reference.rasterize(*parts, *view, 0.0)[0, :, pixels[:, 1], pixels[:, 0]].T.numpy()
    kernel = rasterize(*parts, *view, Projector(0.0, NEARLY_UNCUT))[0, :, pixels[:, 1], pixels[:, 0]].T.numpy()
    assert abs(truth - expected).max() < TOLERANCES["quadrature"] * expected.max()
    assert abs(kernel - expected).max() < TOLERANCES["quadrature_kernel"] * expected.max()


def sub_pixels(frames, n):
    """Frames of a panel with n x n pixels in place of each."""
    fine = frames.clone()
    fine[:, 1] += (0.5 / n - 0.5) * (fine[:, 2] + fine[:, 3])
    fine[:, 2:] /= n
    return fine


@pytest.mark.parametrize(
    ("sigma", "error"), [(0.05, 0.4), (0.2, 0.05), (0.3, 0.04), (0.5, 0.025), (0.7, 0.01), (1.0, 0.003), (2.0, 2e-4)]
)
def test_pixel_average_is_close_to_the_mean_of_sub_pixels(sigma, error):
    """Widths in pixels, errors over the peak: a box becomes a Gaussian of its variance, which shows when narrow."""
    geometry, n, rng = circular(7, 8, views=1), max(16, int(5 / sigma)), np.random.default_rng(4)
    frames = frames_of(geometry)
    for centre in rng.uniform(-1.5, 1.5, (8, 3)) * PIXEL:
        parts = one_gaussian(list(centre), sigma * PIXEL)
        exact = reference.rasterize(*parts, sub_pixels(frames, n), 7 * n, 8 * n, 0.0)
        exact = exact.reshape(7, n, 8, n).mean(dim=(1, 3))
        assert largest_error(rasterize(*parts, frames, 7, 8)[0, 0], exact) < error


@pytest.mark.parametrize("geometry", [circular(13, 16), tilted(13, 16)], ids=["circular", "tilted"])
@pytest.mark.parametrize("sigma", [0.02, 0.05, 0.2])
def test_a_gaussian_narrower_than_a_pixel_keeps_its_mass_wherever_it_sits(geometry, sigma):
    """A small mass m at depth t on ray d adds up to m |d| / (t^2 det[d, column step, row step]) over the pixels."""
    rng = np.random.default_rng(6)
    for centre in rng.uniform(-2, 2, (10, 3)):
        parts = one_gaussian(list(centre), sigma * PIXEL)
        sums = rasterize(*parts, frames_of(geometry), 13, 16).sum(dim=(1, 2, 3))
        for total, (source, first, column_step, row_step) in zip(sums, geometry.ray_frames(), strict=True):
            depth = np.linalg.solve(np.stack([column_step, row_step, first], axis=1), centre - source)[2]
            jacobian = depth**3 * abs(np.linalg.det([first, column_step, row_step]))
            expected = (2 * np.pi) ** 1.5 * (sigma * PIXEL) ** 3 * np.linalg.norm(centre - source) / jacobian
            assert float(total) == pytest.approx(expected, rel=TOLERANCES["narrow_pixel_mass"])


@pytest.mark.parametrize("sigma", [0.5, 2.0, 6.0])
def test_truncation_costs_a_thousandth_of_the_peak(sigma):
    geometry, parts = circular(21, 23, views=1), one_gaussian([0.0, 0.0, 0.0], sigma)
    truth = reference.rasterize(*parts, frames_of(geometry), 21, 23, 1.0)
    image = rasterize(*parts, frames_of(geometry), 21, 23)
    assert largest_error(image, truth) < TOLERANCES["rasterize_truncation"]
    assert (image <= truth * 1.0001).all()


@pytest.mark.parametrize("where", GEOMETRIES)
def test_any_number_of_threads_gives_the_same_bits(where, monkeypatch):
    monkeypatch.setattr("recon.ops.rasterize.cpu_calls.CHUNK", 7)
    geometry, parts = GEOMETRIES[where], [p.float() for p in random_gaussians(9, count=60)]
    view = (frames_of(geometry), geometry.panel.rows, geometry.panel.columns)
    results = []
    try:
        for threads in (1, 2, 3):
            set_threads(threads)
            value, gradients = value_and_gradients(lambda *p: rasterize(*p, *view), parts)
            results.append([value, *gradients])
    finally:
        set_threads(None)
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


def test_bases_do_not_see_each_other():
    geometry = GEOMETRIES["tilted"]
    *shape, values = random_gaussians(10)
    view = (frames_of(geometry), geometry.panel.rows, geometry.panel.columns)
    together = rasterize(*shape, values, *view)
    for m in range(values.shape[1]):
        assert torch.equal(rasterize(*shape, values[:, m : m + 1], *view)[:, 0], together[:, m])


@pytest.mark.parametrize("fraction", [-0.5, -0.13, 1.13, 2.0])
def test_a_gaussian_far_behind_the_source_or_the_panel_contributes_nothing(fraction):
    geometry = circular(9, 10, views=1)
    source, first, column_step, row_step = geometry.ray_frames()[0]
    centre = source + fraction * (first + 4 * column_step + 4 * row_step)
    parts = one_gaussian(list(centre), 2.0)
    value, gradients = value_and_gradients(lambda *p: rasterize(*p, frames_of(geometry), 9, 10), parts)
    assert not value.any()
    assert not any(gradient.any() for gradient in gradients)


def test_a_gaussian_beside_the_panel_contributes_nothing():
    geometry = circular(9, 10, views=1)
    value, gradients = value_and_gradients(
        lambda *p: rasterize(*p, frames_of(geometry), 9, 10), one_gaussian([0.0, 40.0, 0.0], 0.5)
    )
    assert not value.any()
    assert not any(gradient.any() for gradient in gradients)


def test_no_gaussians_make_an_empty_image_in_the_dtype_of_the_coefficients():
    parts = [part[:0].float() for part in random_gaussians(1)]
    value, gradients = value_and_gradients(lambda *p: rasterize(*p, frames_of(circular(3, 4)), 3, 4), parts)
    assert value.shape == (3, 3, 3, 4)
    assert value.dtype == torch.float32
    assert [tuple(g.shape) for g in gradients] == [(0, 3), (0, 3), (0, 4), (0, 3)]


@pytest.mark.wrong_types
def test_arrays_that_do_not_belong_together_are_refused():
    centres, log_scales, quaternions, values = random_gaussians(1)
    with pytest.raises(InputError, match=r"quaternions has shape \(12, 3\), expected \(12, 4\)"):
        rasterize(centres, log_scales, quaternions[:, :3], values, frames_of(circular()), 13, 16)
