"""The data term in one pass over the rays, beside the same by torch in float64."""

import numpy as np
import pytest
import torch
from support.gaussian_scenes import spectral_model
from support.tolerances import TOLERANCES

from recon.ops import deviance as formulas
from recon.ops.likelihood import MeasuredCounts
from recon.ops.likelihood.data_term import RAYS_PER_PIECE, data_term
from spectra.ops.transmit import reference
from spectra.threads import set_threads

VIEWS, ROWS = 2, 3


def some_views(bases, columns, scale=1.0, weighted=True, parts=0, bounds=False):
    """Line integrals, and counts of others nearby, with gains, exposures and weights of their own."""
    rng = np.random.default_rng(columns)
    model = spectral_model(bases + parts)
    lengths = scale * rng.uniform(0, 1, (VIEWS, bases, ROWS, columns)).astype(np.float32)
    profile = rng.uniform(0, 0.5, (parts, ROWS, columns)).astype(np.float32) if parts else None
    gains = rng.uniform(0.5, 2, (len(model), ROWS, columns)).astype(np.float32)
    gains[1, 0] = 0
    exposure = rng.uniform(0.5, 2, (VIEWS, len(model)))
    expected = model.expected(np.moveaxis(with_profile(lengths, profile) * rng.uniform(0.9, 1.1), 1, -1))
    counts = rng.poisson(np.moveaxis(expected, -1, 1) * gains * exposure[:, :, None, None]).astype(np.float32)
    weights = rng.integers(0, 3, counts.shape).astype(np.float32) / 2 if weighted else None
    if bounds:  # of which about half are missed
        weights = np.where(rng.random(counts.shape) < 0.3, -1 / rng.uniform(1.02, 1.5, counts.shape), 1)
        counts, weights = (
            np.where(weights < 0, counts / -weights, counts).astype(np.float32),
            weights.astype(np.float32),
        )
    return lengths, MeasuredCounts(counts, gains, exposure, profile, weights), model


def with_profile(lengths, profile):
    if profile is None:
        return lengths
    return np.concatenate([lengths, np.broadcast_to(profile, (len(lengths), *profile.shape))], axis=1)


def by_torch(lengths, measured, model, dispersion):
    """Gradient and sums by the formulas, and automatic differentiation in float64."""
    along = torch.tensor(lengths.astype(float), requires_grad=True)
    profile = None if measured.profile is None else torch.tensor(measured.profile.astype(float))
    rays = along if profile is None else torch.cat([along, profile.expand(len(along), *profile.shape)], dim=1)
    columns, weights = (torch.tensor(part) for part in (model.columns, model.weights))
    expected = reference.transmit(rays.movedim(1, -1).flatten(0, -2), columns, weights, model.starts.tolist())
    expected = expected.unflatten(0, (len(lengths), *lengths.shape[2:])).movedim(-1, 1)
    scale = torch.tensor(measured.gains * measured.exposure[:, :, None, None])
    expected, counts, used = expected * scale, torch.tensor(measured.counts.astype(float)), scale > 0
    shares = measured.statistical_weights
    shares = torch.ones_like(counts) if shares is None else torch.tensor(shares.astype(float))
    bound, reading, variance = shares < 0, -shares * counts, counts + dispersion**2 * counts**2
    weak = variance / torch.maximum(variance, (counts - reading) ** 2 / 12)
    shares, missed = torch.where(bound, weak, shares), bound & (expected < reading)
    below = torch.where(missed, formulas.deviance(reading.clamp_min(0), expected, dispersion), 0)
    deviances = torch.where(used, shares * formulas.deviance(counts, expected, dispersion) + below, 0)
    (deviances.sum() / 2).backward()
    rows = (
        deviances,
        (shares + missed) * formulas.expected_deviance(expected, dispersion),
        torch.where(bound, 0, formulas.chi_square(counts, expected, dispersion)),
        torch.where(bound, 0, formulas.expected_chi_square(expected, dispersion)),
    )
    sums = [torch.where(used, row, 0).sum(dim=(0, 2, 3)).detach().numpy() for row in rows]
    return along.grad.numpy(), sums


@pytest.mark.parametrize("dispersion", [0.0, 0.02])
@pytest.mark.parametrize("bases", [1, 3])
@pytest.mark.parametrize(("columns", "scale"), [(7, 1.0), (RAYS_PER_PIECE // 2, 0.5), (40, 8.0), (40, 30.0)])
def test_gradient_and_sums_are_those_of_the_formulas(bases, dispersion, columns, scale):
    scan = some_views(bases, columns, scale, weighted=columns == 40)
    gradient, sums = by_torch(*scan, dispersion)
    found = data_term(*scan, dispersion)
    np.testing.assert_allclose(found.gradient, gradient, atol=TOLERANCES["likelihood"] * np.abs(gradient).max())
    for row, right in zip(found[1:], sums, strict=True):
        np.testing.assert_allclose(row, right, rtol=TOLERANCES["likelihood"])


@pytest.mark.parametrize("dispersion", [0.0, 0.02])
def test_lower_bounds_count_where_fewer_are_expected(dispersion):
    scan = some_views(3, 40, bounds=True)
    gradient, sums = by_torch(*scan, dispersion)
    found = data_term(*scan, dispersion)
    np.testing.assert_allclose(found.gradient, gradient, atol=TOLERANCES["likelihood"] * np.abs(gradient).max())
    for row, right in zip(found[1:], sums, strict=True):
        np.testing.assert_allclose(row, right, rtol=TOLERANCES["likelihood"])


def test_a_known_profile_adds_to_every_ray():
    scan = some_views(2, 40, parts=1)
    gradient, sums = by_torch(*scan, 0.01)
    found = data_term(*scan, 0.01)
    np.testing.assert_allclose(found.gradient, gradient, atol=TOLERANCES["likelihood"] * np.abs(gradient).max())
    np.testing.assert_allclose(found.deviances, sums[0], rtol=TOLERANCES["likelihood"])


@pytest.mark.parametrize("scale", [1000.0, -200.0])
def test_rays_without_photons_and_rays_that_amplify_give_finite_numbers(scale):
    lengths, measured, model = some_views(2, 40)
    for values in data_term(lengths * np.float32(scale), measured, model, 0.01):
        assert np.isfinite(values).all()


def test_rays_that_are_no_numbers_are_not_hidden():
    lengths, measured, model = some_views(2, 40)
    lengths[0, 0, 1, 3] = np.nan
    found = data_term(lengths, measured, model, 0.01)
    assert np.isnan(found.deviances).all()
    assert np.isnan(found.chi_squares).all()


def test_any_number_of_threads_gives_the_same_bits():
    scan, results = some_views(3, RAYS_PER_PIECE), []
    try:
        for threads in (1, 3):
            set_threads(threads)
            results.append(data_term(*scan, 0.01))
    finally:
        set_threads(None)
    assert all(np.array_equal(a, b) for a, b in zip(*results, strict=True))
