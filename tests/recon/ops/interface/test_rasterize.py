import math

import numpy as np
import pytest
import torch
from scipy.integrate import quad
from scipy.special import ndtr

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from recon.ops.interface.arrays import DividedTensors
from recon.ops.interface.rasterize import rasterize_divided
from recon.ops.interface.reference import line_integrals
from recon.ops.rasterize.projector import Projector
from recon.ops.rasterize.reference import whitening

BASES = 2
SIDE = 24
PANEL = (SIDE, SIDE)


def gaussians(count: int = 12, seed: int = 3, width: float = 0.3) -> tuple[torch.Tensor, ...]:
    """Centres, log-scales, quaternions, planes, and coefficients below and above, float64."""
    random = np.random.default_rng(seed)
    scales = np.log(random.uniform(1.5, 5.0, (count, 3)))
    planes = np.stack([random.normal(0, 0.7, count), np.full(count, width)], axis=1)
    parts = [random.uniform(-8, 8, (count, 3)), scales, random.normal(size=(count, 4)), planes]
    return tuple(torch.from_numpy(p) for p in [*parts, *random.uniform(0, 0.05, (2, count, BASES))])


def frames(views: int = 2) -> torch.Tensor:
    angles = np.linspace(0.3, 3, views)
    return torch.from_numpy(Geometry.circular(100.0, 180.0, angles, Panel(SIDE, SIDE, 2.5)).ray_frames())


def rays(frame: torch.Tensor, finer: int = 1) -> tuple[torch.Tensor, torch.Tensor]:
    """Origins and directions of the rays of a view; of `finer` x `finer` points of each pixel."""
    at = (torch.arange(SIDE * finer, dtype=torch.float64) + 0.5) / finer - 0.5
    directions = frame[1] + at[None, :, None] * frame[2] + at[:, None, None] * frame[3]
    return frame[0].expand(directions.shape).reshape(-1, 3), directions.reshape(-1, 3)


def reference_images(parts: tuple[torch.Tensor, ...], of: torch.Tensor, finer: int = 1) -> torch.Tensor:
    images = []
    for frame in of:
        values = line_integrals(DividedTensors(*parts), *rays(frame, finer)).T.reshape(BASES, SIDE, finer, SIDE, finer)
        images.append(values.mean(dim=(2, 4)))
    return torch.stack(images)


def test_the_integral_along_a_ray_is_that_of_quadrature():
    parts = gaussians(20, seed=0)
    matrices = whitening(*parts[1:3]).numpy()
    random = np.random.default_rng(1)
    for k in range(20):
        centre, plane, low, high = (parts[i][k].numpy() for i in (0, 3, 4, 5))
        origin, direction = centre + random.normal(size=3) * 4, random.normal(size=3)

        def density(t, k=k, centre=centre, plane=plane, low=low, high=high, origin=origin, direction=direction):
            w = matrices[k] @ (origin + t * direction - centre)
            part = ndtr((w[2] - plane[0]) / plane[1])
            return math.exp(-w @ w / 2) * (low[0] + (high[0] - low[0]) * part)

        middle = -(matrices[k] @ direction) @ (matrices[k] @ (origin - centre)) / np.sum((matrices[k] @ direction) ** 2)
        reach = 9 / np.linalg.norm(matrices[k] @ direction)
        wanted = quad(density, middle - reach, middle + reach, epsabs=1e-13, limit=400)[0] * np.linalg.norm(direction)
        one = tuple(part[k : k + 1] for part in parts)
        found = line_integrals(DividedTensors(*one), torch.from_numpy(origin)[None], torch.from_numpy(direction)[None])
        assert float(found[0, 0]) == pytest.approx(wanted, rel=1e-8)


@pytest.mark.parametrize("width", [0.02, 0.3, 2.0])
def test_rays_through_pixel_centres_are_those_of_the_reference(width):
    parts, of = gaussians(width=width), frames()
    found = rasterize_divided(DividedTensors(*parts), of, PANEL, Projector(0.0, 5.0))
    wanted = reference_images(parts, of)
    assert float((found - wanted).abs().max()) < 3e-5 * float(wanted.max())


@pytest.mark.parametrize("seed", range(4))
def test_rows_of_pixels_far_from_a_plane_lie_on_its_right_side(seed):
    centres, _, turns, planes, below, above = gaussians(40, seed)
    random = np.random.default_rng(seed)
    scales = torch.from_numpy(np.log(random.uniform(0.4, 8.0, centres.shape)))  # flat and long ones
    planes[:, 0] = torch.from_numpy(random.uniform(-8, 8, len(planes)))
    parts, of = (centres, scales, turns, planes, below, above), frames()
    found = rasterize_divided(DividedTensors(*parts), of, PANEL, Projector(0.0, 5.0))
    wanted = reference_images(parts, of)
    assert float((found - wanted).abs().max()) < 3e-5 * float(wanted.max())


def test_sides_that_agree_make_a_plain_gaussian():
    parts, of = gaussians(), frames()
    same = (*parts[:5], parts[4])
    found = rasterize_divided(DividedTensors(*same), of, PANEL, Projector(1.0, 4.0))
    from recon.ops.rasterize import rasterize

    wanted = rasterize(*(p.float() for p in (*parts[:3], parts[4])), of, SIDE, SIDE, Projector(1.0, 4.0))
    torch.testing.assert_close(found.float(), wanted, rtol=1e-4, atol=1e-6)


def test_gradients_are_those_of_the_reference():
    of = frames()
    weights = torch.from_numpy(np.random.default_rng(5).normal(size=(len(of), BASES, SIDE, SIDE)))
    gradients = []
    for images in (
        lambda parts: rasterize_divided(DividedTensors(*parts), of, PANEL, Projector(0.0, 5.0)),
        lambda parts: reference_images(parts, of),
    ):
        parts = tuple(part.clone().requires_grad_() for part in gaussians())
        (images(parts) * weights).sum().backward()
        gradients.append([part.grad for part in parts])
    for name, found, wanted in zip(["centres", "scales", "turns", "planes", "below", "above"], *gradients, strict=True):
        assert float((found - wanted).abs().max()) < 2e-3 * float(wanted.abs().max()), name


@pytest.mark.parametrize(("width", "error"), [(0.02, 0.03), (0.3, 0.01)])
def test_pixels_hold_means_of_many_rays(width, error):
    parts, of = gaussians(width=width), frames(1)
    wanted = reference_images(parts, of, finer=16)
    found = rasterize_divided(DividedTensors(*parts), of, PANEL, Projector(1.0, 5.0))
    middle = rasterize_divided(DividedTensors(*parts), of, PANEL, Projector(0.0, 5.0))
    worst, unaveraged = (float((images - wanted).abs().max() / wanted.max()) for images in (found, middle))
    assert worst < min(error, unaveraged)


def test_gaussians_at_the_panel_are_cut_off_there():
    """Against many points along rays that end at the panel; sides count as Gaussians of their moments there."""
    parts, of = gaussians(1, width=0.05), frames(1)
    parts[0][0] = of[0, 0] + 0.97 * (of[0, 1] + SIDE / 2 * (of[0, 2] + of[0, 3]))
    found = rasterize_divided(DividedTensors(*parts), of, PANEL, Projector(0.0, 5.0))
    origins, directions = rays(of[0])
    matrices = whitening(*parts[1:3])[0]
    at = torch.linspace(0, 1, 4001, dtype=torch.float64)
    points = origins[:, None] + at[:, None] * directions[:, None]
    w = (points - parts[0][0]) @ matrices.T
    part = torch.special.ndtr((w[..., 2] - parts[3][0, 0]) / parts[3][0, 1])
    height = torch.exp(-(w * w).sum(-1) / 2)
    values = height[..., None] * (parts[4][0] + (parts[5][0] - parts[4][0]) * part[..., None])
    wanted = (torch.trapezoid(values, at, dim=1) * directions.norm(dim=1, keepdim=True)).T.reshape(BASES, SIDE, SIDE)
    assert float(found[0].sum()) == pytest.approx(float(wanted.sum()), rel=0.02)
    assert float((found[0] - wanted).abs().max()) < 0.3 * float(wanted.max())  # the plane is blurred
