"""Any pose of source and panel, Gaussians at the ends of rays, parallel beams, and the local-affine projection."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support.gaussian_scenes import GEOMETRIES, PITCH, PIXEL, circular, frames_of, one_gaussian, random_gaussians
from support.tolerances import TOLERANCES

from phantomgen.effects.pose_jitter import Jitter, jittered
from phantomgen.geometry import orbits
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.panel_mount import Mount, mounted
from phantomgen.geometry.poses import Geometry
from recon.ops.arguments import RayFrame
from recon.ops.rasterize import Projector, cutoff_for, rasterize, reference
from recon.ops.rasterize import cpu_calls as on_cpu
from recon.ops.rasterize import near_field as near
from spectra.errors import InputError

ROWS, COLUMNS, NEARLY_UNCUT = 5, 6, 5.0
NODES, WEIGHTS = np.polynomial.legendre.leggauss(400)  # on a ray of 200 mm: less than 0.8 mm apart


def quadrature(parts, frames, rows, columns):
    """Gauss-Legendre rule from the source to the panel, rotations by scipy."""
    centres, log_scales, quaternions, values = (part.detach().numpy() for part in parts)
    turns = Rotation.from_quat(quaternions[:, [1, 2, 3, 0]]).as_matrix()
    whitening = np.exp(-log_scales)[:, :, None] * turns.transpose(0, 2, 1)
    images = []
    for source, first, column_step, row_step in frames.numpy():
        d = first + np.arange(columns)[:, None] * column_step + np.arange(rows)[:, None, None] * row_step
        points = source + (NODES[:, None, None, None] + 1) / 2 * d
        u = np.einsum("gij,trcgj->trcgi", whitening, points[:, :, :, None] - centres)
        density = np.einsum("trcg,gm->trcm", np.exp(-0.5 * (u * u).sum(-1)), values)
        images.append(np.einsum("t,trcm,rc->mrc", WEIGHTS / 2, density, np.linalg.norm(d, axis=-1)))
    return torch.from_numpy(np.array(images))


def value_and_gradients(function, parts, frames, *options, seed=0):
    leaves = [part.clone().requires_grad_() for part in parts]
    value = function(*leaves, frames, ROWS, COLUMNS, *options)
    cotangent = torch.from_numpy(np.random.default_rng(seed).normal(size=value.shape))
    return value.detach(), torch.autograd.grad(value, leaves, cotangent)


def assert_same(found, expected, values=TOLERANCES["kernel_value"], slopes=TOLERANCES["kernel_gradient"]):
    (image, gradients), (truth, right) = found, expected
    assert (image - truth).abs().max() < values * truth.abs().max()
    for gradient, wanted in zip(gradients, right, strict=True):
        assert (gradient - wanted).norm() < slopes * wanted.norm()


def random_frames(rng, views=2):
    """Sources and panels on all sides, oblong and oblique pixels, rays up to some 45 degrees off the axis."""
    turns = Rotation.random(views, rng).as_matrix()
    size = rng.uniform(0.3, 25.0, (views, 1))  # a pixel on the panel
    back, ahead = rng.uniform(20, 60, (views, 1)), rng.uniform(15, 80, (views, 1))
    oblique = turns + rng.normal(scale=0.15, size=turns.shape)
    steps = oblique[:, :, :2] * size[:, :, None] * rng.uniform(0.7, 1.4, (views, 1, 2))
    offset = np.einsum("vik,vk->vi", steps, rng.uniform(-0.5, 0.5, (views, 2)) * [COLUMNS, ROWS])
    first = (
        turns[:, :, 2] * (back + ahead) + offset - np.einsum("vik,k->vi", steps, [(COLUMNS - 1) / 2, (ROWS - 1) / 2])
    )
    return torch.from_numpy(np.stack([-turns[:, :, 2] * back, first, steps[:, :, 0], steps[:, :, 1]], 1))


def in_view(parts, frames):
    """The same Gaussians, the first two of them on rays through the middle of the panel in all views but the last."""
    source, first, du, dv = frames[0]
    ray = first + (COLUMNS - 1) / 2 * du + (ROWS - 1) / 2 * dv
    centres = parts[0].clone()
    centres[0], centres[1] = source + 0.5 * ray, source + 0.6 * ray
    return centres, *parts[1:]


@settings(max_examples=25)
@given(seed=st.integers(0, 10**6), footprint=st.sampled_from([0.0, 1.0]), spread=st.sampled_from([4.0, 40.0]))
def test_any_pose_gives_the_values_and_gradients_of_the_reference(seed, footprint, spread):
    """With a spread of 40 mm, Gaussians stand before, around and behind sources and panels."""
    rng = np.random.default_rng(seed)
    frames = random_frames(rng)
    parts = in_view(random_gaussians(seed, 8, 2, sigma=(0.5, 6.0), spread=spread, pixel=1.0), frames)
    expected = value_and_gradients(reference.rasterize, parts, frames, footprint)
    assert_same(value_and_gradients(rasterize, parts, frames, Projector(footprint, NEARLY_UNCUT)), expected)


@pytest.mark.parametrize("seed", range(6))
def test_the_reference_is_quadrature_from_source_to_panel(seed):
    frames = random_frames(np.random.default_rng(seed), 3)
    parts = in_view(random_gaussians(seed, 8, 2, sigma=(1.0, 8.0), spread=40.0, pixel=1.0), frames)
    truth = quadrature(parts, frames, ROWS, COLUMNS)
    found = reference.rasterize(*parts, frames, ROWS, COLUMNS, 0.0)
    assert (found - truth).abs().max() < TOLERANCES["quadrature"] * truth.max()


def at(where, sigma=2.0, bases=2, shift=(0.0, 0.0)):
    """A ball and a needle at a part of the way from source to panel, beside the central ray by `shift` [mm]."""
    frames = frames_of(Geometry.circular(60.0, 100.0, np.array([0.3]), Panel(ROWS, COLUMNS, 4 * PITCH)))
    source, first, du, dv = frames[0]
    ray = first + (COLUMNS - 1) / 2 * du + (ROWS - 1) / 2 * dv
    centre = source + where * ray + shift[0] * du / du.norm() + shift[1] * dv / dv.norm()
    log_scales = torch.tensor([[sigma] * 3, [3 * sigma, 0.5 * sigma, sigma]]).double().log()
    turns = torch.tensor([[1.0, 0, 0, 0], [0.9, 0.3, -0.2, 0.1]]).double()
    return (centre.repeat(2, 1), log_scales, turns, torch.ones(2, bases).double()), frames


@pytest.mark.parametrize("footprint", [0.0, 1.0])
@pytest.mark.parametrize("shift", [(0.0, 0.0), (2.0, -3.0)])
@pytest.mark.parametrize("where", [-0.08, -0.02, 1e-9, 0.03, 0.1, 0.9, 0.98, 1.0, 1.05])
def test_a_gaussian_around_the_source_or_the_panel_counts_in_part(where, shift, footprint):
    parts, frames = at(where, shift=shift)
    expected = value_and_gradients(reference.rasterize, parts, frames, footprint)
    if footprint == 0:
        truth = quadrature(parts, frames, ROWS, COLUMNS)
        assert (expected[0] - truth).abs().max() < TOLERANCES["quadrature"] * truth.max()
    assert_same(value_and_gradients(rasterize, parts, frames, Projector(footprint, NEARLY_UNCUT)), expected)


@pytest.mark.parametrize("sigma", [0.05, 0.3, 1.0])
@pytest.mark.parametrize("where", [0.995, 1.0, 1.002])
def test_a_narrow_gaussian_at_the_panel_keeps_its_mass(where, sigma):
    """Widths in pixels of the panel."""
    parts, frames = at(where, sigma * 4 * PITCH, shift=(1.3, -0.7))
    expected = value_and_gradients(reference.rasterize, parts, frames, 1.0)
    assert_same(value_and_gradients(rasterize, parts, frames, Projector(1.0, NEARLY_UNCUT)), expected)


@pytest.mark.parametrize("end", [0.0, 1.0])
def test_values_do_not_jump_where_the_ends_of_rays_begin_to_count(end):
    """`near.classify` decides; on both sides the line integrals are those of the whole line to 3e-7."""
    where = [end + (1 - 2 * end) * 0.01 * step for step in range(1, 31)]
    jumps = []
    for cut in where:
        parts, frames = at(cut, 1.0)
        truth = reference.rasterize(*parts, frames, ROWS, COLUMNS, 1.0)
        kernel = rasterize(*parts, frames, ROWS, COLUMNS, Projector(1.0, NEARLY_UNCUT))
        jumps.append(float((kernel - truth).abs().max() / truth.max()))
    assert max(jumps) < TOLERANCES["kernel_value"]


@pytest.mark.parametrize("footprint", [0.0, 1.0])
def test_a_gaussian_centred_on_the_source(footprint):
    """Half a line integral, without a projected centre; its gradients are those of one that is 1e-9 mm ahead."""
    parts, frames = at(0.0)
    found = value_and_gradients(rasterize, parts, frames, Projector(footprint, NEARLY_UNCUT))
    truth = quadrature(parts, frames, ROWS, COLUMNS)
    assert (found[0] - truth).abs().max() < 1e-6 * truth.max()
    assert_same(found, value_and_gradients(rasterize, at(1e-11)[0], frames, Projector(footprint, NEARLY_UNCUT)))


def test_gaussians_between_source_and_panel_take_the_fast_way():
    parts, frames = random_gaussians(1, 40), frames_of(circular())
    matrices = reference.whitening(*parts[1:3]).numpy()
    for frame in frames.numpy():
        view = RayFrame(frame, np.linalg.inv(np.stack([frame[2], frame[3], frame[1]], -1)))
        places = {near.classify(p, a, view, 13.7) for p, a in zip(parts[0].numpy(), matrices, strict=True)}
        assert places == {near.BETWEEN}


ANGLES, PANEL = np.array([0.3, 2.0, 4.5]), Panel(ROWS, COLUMNS, (1.8, 2.4))
CIRCLE = Geometry.circular(60.0, 100.0, ANGLES, PANEL)
ORBITS = {
    "half-fan": mounted(CIRCLE, Mount(offset=(5.0, -1.0))),
    "tilted and rolled panel": mounted(CIRCLE, Mount(tilt=(0.2, -0.3, 0.5))),
    "helical": orbits.helical(60.0, 100.0, ANGLES, 4.0, PANEL, -2.0),
    "laminography": orbits.laminography(60.0, 100.0, ANGLES, 0.6, PANEL),
    "parallel, tilted": orbits.parallel(40.0, ANGLES, PANEL, 0.3),
    "parallel, tilted panel": mounted(orbits.parallel(40.0, ANGLES, PANEL), Mount(tilt=(0.2, -0.3, 0.5))),
    "jitter": jittered(CIRCLE, Jitter(2.0, 2.0, 0.1), 3),
}


@pytest.mark.parametrize("orbit", ORBITS)
def test_orbits_and_mounts_of_the_simulator(orbit):
    parts, frames = random_gaussians(7, 10, 2, sigma=(0.3, 3.0), spread=4.0), frames_of(ORBITS[orbit])
    expected = value_and_gradients(reference.rasterize, parts, frames, 1.0)
    assert_same(value_and_gradients(rasterize, parts, frames, Projector(1.0, NEARLY_UNCUT)), expected)


def parallel(views=3, seed=1):
    rng = np.random.default_rng(seed)
    turns = Rotation.random(views, rng).as_matrix()
    pitch = (PIXEL, 1.2 * PIXEL)
    ways, steps = turns[:, :, 2], (pitch[1] * turns[:, :, 0], pitch[0] * turns[:, :, 1])
    return Geometry.parallel(ways, 40.0 * ways, *steps, Panel(ROWS, COLUMNS, pitch))


@pytest.mark.parametrize("sigma", [(0.1, 0.3), (0.5, 2.0), (0.3, 9.0)])
def test_parallel_beams_are_as_exact_as_cones(sigma):
    """The closed form with a constant direction: centres shifted into the panel, covariances projected on it."""
    geometry, parts = parallel(), random_gaussians(4, 10, 2, sigma=sigma, spread=2.0)
    frames = frames_of(geometry)
    truth = []
    spread = torch.linalg.inv(reference.whitening(*parts[1:3]))
    for frame, way in zip(frames, torch.from_numpy(geometry.ray_direction), strict=True):
        axes = torch.stack([frame[2], frame[3], way])
        to_pixels = torch.linalg.inv(axes.mT)[:2]
        corner = frame[0] + frame[1]
        place, narrow = (parts[0] - corner) @ to_pixels.mT, (to_pixels @ spread) @ (to_pixels @ spread).mT
        y, x = torch.meshgrid(torch.arange(ROWS), torch.arange(COLUMNS), indexing="ij")
        delta = torch.stack([x, y], -1)[:, :, None] - place
        square = torch.einsum("rcni,nij,rcnj->rcn", delta, torch.linalg.inv(narrow), delta)
        height = math.sqrt(2 * math.pi) / (reference.whitening(*parts[1:3]) @ way).norm(dim=-1)
        truth.append(torch.einsum("rcn,n,nm->mrc", torch.exp(-square / 2), height, parts[3]))
    kernel = rasterize(*parts, frames, ROWS, COLUMNS, Projector(0.0, NEARLY_UNCUT))
    assert (kernel - torch.stack(truth)).abs().max() < TOLERANCES["kernel_value"] * torch.stack(truth).max()
    expected = value_and_gradients(reference.rasterize, parts, frames, 1.0)
    assert_same(value_and_gradients(rasterize, parts, frames, Projector(1.0, NEARLY_UNCUT)), expected)


@pytest.mark.parametrize("footprint", [0.0, 1.0])
@pytest.mark.parametrize("seed", range(3))
def test_local_affine_projection_is_a_gaussian_in_the_panel(seed, footprint):
    frames = random_frames(np.random.default_rng(seed))
    parts = in_view(random_gaussians(seed, 8, 2, sigma=(0.3, 4.0), pixel=1.0), frames)
    expected = value_and_gradients(reference.local_affine, parts, frames, footprint)
    projector = Projector(footprint, NEARLY_UNCUT, "local-affine")
    assert_same(value_and_gradients(rasterize, parts, frames, projector), expected)


def test_local_affine_is_exact_on_the_ray_through_the_centre_only():
    parts = one_gaussian([3.0, -4.0, 2.0], [4.0, 1.0, 0.5])
    source = frames_of(circular(views=1))[0, 0]
    ray, step = parts[0][0] - source, torch.tensor([0.0, 0.7, 1.1]).double()
    frames = torch.stack([source, 1.6 * ray - 2 * step, step, torch.tensor([0.0, 1.0, -0.5]).double()])[None]
    exact, affine = (
        rasterize(*parts, frames, 1, 5, Projector(0.0, kind=kind))[0, 0, 0] for kind in ("exact", "local-affine")
    )
    assert affine[2] == pytest.approx(float(exact[2]), rel=1e-5)
    assert abs(affine[0] - exact[0]) > 1e-3 * exact[2]


@pytest.mark.parametrize("error", [1e-5, 1e-4, 1e-3, 1e-2])
def test_a_cutoff_keeps_its_error_of_the_peak_and_of_the_sum(error):
    parts = one_gaussian([0.0, 0.0, 0.0], 3.0)
    view, projector = (frames_of(circular(61, 61, views=1)), 61, 61), Projector(cutoff=cutoff_for(error))
    truth, image = reference.rasterize(*parts, *view, 1.0), rasterize(*parts, *view, projector)
    worst = float((truth - image).max() / truth.max())
    assert 0.5 * error < worst < 1.01 * error + 2e-6
    assert float(1 - image.sum() / truth.sum()) == pytest.approx(error, rel=0.05, abs=2e-5)


@pytest.mark.parametrize("error", [0.0, 1e-6, 1.0, math.nan])
def test_errors_of_truncation_that_cannot_be_are_refused(error):
    with pytest.raises(InputError, match=r"error of truncation must be from 3\.7e-06 to below 1"):
        cutoff_for(error)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"cutoff": 5.1}, "cutoff must be above 0 and at most 5"),
        ({"cutoff": 0.0}, "cutoff"),
        ({"kind": "ewa"}, "ewa"),
    ],
)
def test_options_that_cannot_be_are_refused(options, words):
    with pytest.raises(InputError, match=words):
        Projector(**options)


@pytest.mark.parametrize("where", GEOMETRIES)
@pytest.mark.parametrize("kind", ["exact", "local-affine"])
def test_views_at_a_time_do_not_change_a_bit(where, kind, monkeypatch):
    geometry, parts = GEOMETRIES[where], [part.float() for part in random_gaussians(9, 30, sigma=(0.3, 12.0))]
    view, results = (frames_of(geometry), geometry.panel.rows, geometry.panel.columns, Projector(kind=kind)), []
    for size in (on_cpu.TABLE_BYTES, 52 * 30 * 2, 1):
        monkeypatch.setattr(on_cpu, "TABLE_BYTES", size)
        leaves = [part.clone().requires_grad_() for part in parts]
        image = rasterize(*leaves, *view)
        cotangent = torch.from_numpy(np.random.default_rng(1).normal(size=image.shape)).float()
        results.append([image, *torch.autograd.grad(image, leaves, cotangent)])
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


def test_the_order_of_gaussians_matters_to_rounding_only():
    geometry, parts = GEOMETRIES["tilted"], random_gaussians(11, 40, sigma=(0.3, 9.0))
    order = torch.from_numpy(np.random.default_rng(0).permutation(40))
    view = (frames_of(geometry), geometry.panel.rows, geometry.panel.columns)
    one, other = rasterize(*parts, *view), rasterize(*(part[order] for part in parts), *view)
    assert (one - other).abs().max() < TOLERANCES["float32_sums"] * one.max()


@settings(max_examples=15)
@given(seed=st.integers(0, 10**6))
def test_coefficients_and_images_are_adjoint(seed):
    """<A c, y> = <c, A^T y>: the gradient in the coefficients is the transpose of the projection."""
    rng = np.random.default_rng(seed)
    frames = random_frames(rng)
    *shape, values = in_view(random_gaussians(seed, 12, 3, sigma=(0.5, 6.0), spread=20.0, pixel=1.0), frames)
    values.requires_grad_()
    image = rasterize(*shape, values, frames, ROWS, COLUMNS)
    cotangent = torch.from_numpy(rng.uniform(0.5, 1.5, image.shape))
    (back,) = torch.autograd.grad(image, values, cotangent)
    ahead, behind = (image.detach() * cotangent).sum(), (back * values.detach()).sum()
    assert float(behind) == pytest.approx(float(ahead), rel=TOLERANCES["float32_sums"])


@pytest.mark.parametrize("where", [0.5, 0.97, 0.02])
def test_gradients_are_finite_differences_of_the_float64_reference(where):
    parts, frames = at(where, 3.0, bases=1, shift=(1.0, 2.0))
    cotangent = torch.from_numpy(np.random.default_rng(0).normal(size=(1, 1, ROWS, COLUMNS)))
    leaves = [part.clone().requires_grad_() for part in parts]
    gradients = torch.autograd.grad(
        rasterize(*leaves, frames, ROWS, COLUMNS, Projector(1.0, NEARLY_UNCUT)), leaves, cotangent
    )
    for which, gradient in enumerate(gradients):
        numeric = torch.zeros_like(gradient)
        for i in range(numeric.numel()):
            sums = []
            for step in (1e-5, -1e-5):
                moved = [part.clone() for part in parts]
                moved[which].view(-1)[i] += step
                sums.append((reference.rasterize(*moved, frames, ROWS, COLUMNS, 1.0) * cotangent).sum())
            numeric.view(-1)[i] = (sums[0] - sums[1]) / 2e-5
        assert (gradient - numeric).norm() < TOLERANCES["kernel_gradient"] * numeric.norm()
