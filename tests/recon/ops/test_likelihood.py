from itertools import pairwise

import numpy as np
import pytest
import torch
from support.gaussian_scenes import spectral_model
from support.tolerances import TOLERANCES

from recon.ops.deviance import deviance
from recon.ops.likelihood import BLOCK, MeasuredCounts, likelihood, tensors
from recon.ops.likelihood.reference import half_deviance
from recon.ops.nonnegative_newton import as_matrices
from spectra.errors import InputError
from spectra.ops.transmit import reference as transmit
from spectra.threads import set_threads
from spectra.transmission import Transmission


def some_rays(model, bases, views=2, rows=3, columns=BLOCK // 2 + 1, seed=1, scale=1.0):
    """Line integrals, and counts of others nearby, with gains and exposures of their own."""
    rng = np.random.default_rng(seed)
    lengths = scale * rng.uniform(0, 1, (bases, views, rows, columns)).astype(np.float32)
    gains = rng.uniform(0.5, 2, (len(model), rows, columns)).astype(np.float32)
    exposure = rng.uniform(0.5, 2, (views, len(model)))
    near = np.moveaxis(lengths * rng.uniform(0.9, 1.1, lengths.shape), 0, -1)
    parts = np.zeros((*near.shape[:-1], len(model.columns) - bases))
    expected = np.moveaxis(model.expected(np.concatenate([near, parts], axis=-1)), -1, 1)
    counts = rng.poisson(expected * gains * exposure[:, :, None, None]).astype(np.float32)
    return lengths, counts, gains, exposure


def by_reference(lengths, counts, gains, exposure, model, dispersion, profile=None):
    """Half the deviance and its gradient, by automatic differentiation in float64."""
    known = np.zeros((0, *gains.shape[1:])) if profile is None else profile
    known = np.broadcast_to(known[:, None], (len(known), len(counts), *gains.shape[1:]))
    flat = torch.tensor(np.concatenate([lengths, known]).reshape(len(lengths) + len(known), -1).T.astype(float))
    flat.requires_grad_()
    scale = np.moveaxis(gains * exposure[:, :, None, None], 1, -1).reshape(-1, len(gains)).astype(float)
    y = np.moveaxis(counts, 1, -1).reshape(-1, len(gains)).astype(float)
    arrays = (torch.from_numpy(a) for a in (y, scale, model.columns, model.weights))
    value = half_deviance(flat, *arrays, model.starts.tolist(), dispersion)
    (gradient,) = torch.autograd.grad(value, flat)
    return value.item(), gradient[:, : len(lengths)].T.reshape(lengths.shape).numpy()


@pytest.mark.parametrize("dispersion", [0.0, 0.02])
@pytest.mark.parametrize("bases", [1, 2, 3])
@pytest.mark.parametrize("columns", [1, BLOCK // 2 + 1])
def test_value_and_gradient_are_those_of_the_reference(bases, dispersion, columns):
    model = spectral_model(bases)
    rays = some_rays(model, bases, columns=columns)
    value, gradient = by_reference(*rays, model, dispersion)
    deviances, found, *curvatures = likelihood(rays[0], MeasuredCounts(*rays[1:]), model, dispersion)
    np.testing.assert_allclose(deviances.sum() / 2, value, rtol=TOLERANCES["likelihood"])
    np.testing.assert_allclose(found, gradient, atol=TOLERANCES["likelihood"] * np.abs(gradient).max())
    assert curvatures == [None, None]


@pytest.mark.parametrize("kernel", ["cpu", "tensors"])
@pytest.mark.parametrize("dispersion", [0.0, 0.02])
def test_lower_bounds_add_the_deviance_from_the_reading_to_a_weak_one_from_the_open_beam(kernel, dispersion):
    model = spectral_model(2)
    lengths, _, gains, exposure = some_rays(model, 2)
    flat = torch.tensor(lengths.reshape(2, -1).T.astype(float), requires_grad=True)
    scale = torch.tensor(np.moveaxis(gains * exposure[:, :, None, None], 1, -1).reshape(-1, len(model)))
    columns, weights = torch.from_numpy(model.columns), torch.from_numpy(model.weights)
    expected = transmit.transmit(flat, columns, weights, model.starts.tolist()) * scale
    air = torch.from_numpy(model.open_beam) * scale
    reading = torch.tensor(np.random.default_rng(3).uniform(0.7, 1.3, expected.shape)) * expected.detach()
    reading = torch.minimum(reading, 0.95 * air)
    variance = air + dispersion**2 * air**2
    weak = variance / torch.maximum(variance, (air - reading) ** 2 / 12)
    below = torch.where(expected < reading, deviance(reading, expected, dispersion), 0.0)
    value = (weak * deviance(air, expected, dispersion) + below).sum() / 2
    (gradient,) = torch.autograd.grad(value, flat)
    whole, bounds = (
        part.float().numpy().reshape(2, 3, -1, len(model)).transpose(0, 3, 1, 2) for part in (air, -reading / air)
    )
    measured = MeasuredCounts(whole, gains, exposure, None, bounds)
    how = likelihood if kernel == "cpu" else tensors.likelihood
    found = how(lengths if kernel == "cpu" else torch.from_numpy(lengths), measured, model, dispersion, True)
    right = gradient.T.reshape(lengths.shape).numpy()
    assert float(sum(found.deviances)) / 2 == pytest.approx(value.item(), rel=TOLERANCES["likelihood"])
    np.testing.assert_allclose(np.asarray(found.gradient), right, atol=TOLERANCES["likelihood"] * np.abs(right).max())
    assert (as_matrices(np.asarray(found.curvatures)).trace(axis1=-2, axis2=-1) > 0).all()


def test_a_known_profile_adds_to_every_ray():
    whole = spectral_model(3)
    profile = np.random.default_rng(2).uniform(0, 1, (1, 3, 40))
    rays = some_rays(whole, 2, columns=40)
    value, gradient = by_reference(*rays, whole, 0.01, profile)
    deviances, found, *_ = likelihood(rays[0], MeasuredCounts(*rays[1:], profile), whole, 0.01)
    np.testing.assert_allclose(deviances.sum() / 2, value, rtol=TOLERANCES["likelihood"])
    np.testing.assert_allclose(found, gradient, atol=TOLERANCES["likelihood"] * np.abs(gradient).max())


def test_information_is_the_expected_square_of_the_gradient_where_counts_are_as_expected():
    model = spectral_model(3)
    lengths, counts, gains, exposure = some_rays(model, 3, columns=5)
    fisher = likelihood(lengths, MeasuredCounts(counts, gains, exposure), model, 0.02, information=True).curvatures
    expected, slopes = model.expected_and_jacobian(np.moveaxis(lengths, 0, -1).astype(float))
    scale = np.moveaxis(gains * exposure[:, :, None, None], 1, -1)
    y = expected * scale
    most = np.maximum(y, np.moveaxis(counts, 1, -1))
    right = np.einsum("...c,...cm,...cn->...mn", (scale / y) ** 2 * most / (1 + 0.02**2 * most), slopes, slopes)
    np.testing.assert_allclose(as_matrices(fisher), right, rtol=1e-5)


@pytest.mark.parametrize("dispersion", [0.0, 0.02])
@pytest.mark.parametrize("parts", [0, 1])
@pytest.mark.parametrize("missing", [0.0, 0.5])
def test_both_curvatures_are_the_second_derivatives_where_fewer_counts_arrive(missing, parts, dispersion):
    """Without residuals the Fisher matrix alone is; with them, both together are at least that."""
    bases, model = 2, spectral_model(2 + parts)
    lengths, _, gains, exposure = some_rays(model, bases, columns=4)
    profile = np.random.default_rng(2).uniform(0, 1, (parts, *gains.shape[1:])) if parts else None
    known = np.broadcast_to(np.zeros((0, 2, 3, 4)) if profile is None else profile[:, None], (parts, 2, 3, 4))
    along = np.moveaxis(np.concatenate([lengths, known]), 0, -1).astype(float)
    scale = np.moveaxis(gains * exposure[:, :, None, None], 1, -1).astype(float)
    counts = (1 - missing) * model.expected(along) * scale
    measured = MeasuredCounts(np.moveaxis(counts, -1, 1).astype(np.float32), gains, exposure, profile)
    found = likelihood(lengths, measured, model, dispersion, information=True)
    both = as_matrices(found.curvatures + found.residual_curvatures)
    arrays = [torch.from_numpy(a) for a in (model.columns, model.weights)]

    def half(line, y, gain):
        return half_deviance(line[None], y[None], gain[None], *arrays, model.starts.tolist(), dispersion)

    rays = [torch.from_numpy(part.reshape(-1, part.shape[-1])) for part in (along, counts, scale)]
    right = np.array(
        [torch.autograd.functional.hessian(lambda x, y=y, g=g: half(x, y, g), x) for x, y, g in zip(*rays, strict=True)]
    )
    right = right[:, :bases, :bases].reshape(both.shape)
    if missing == 0:
        np.testing.assert_allclose(found.residual_curvatures, 0, atol=1e-3 * np.abs(found.curvatures).max())
        np.testing.assert_allclose(both, right, rtol=2e-3)
    else:
        assert (np.linalg.eigvalsh(both - right) > -1e-5 * np.abs(right).max()).all()
    if dispersion == 0:
        exact = as_matrices((1 - missing) * found.curvatures + found.residual_curvatures)
        np.testing.assert_allclose(exact, right, rtol=2e-3)


@pytest.mark.parametrize("blind", ["gain", "exposure"])
def test_a_channel_that_was_not_measured_contributes_nothing(blind):
    model = spectral_model(2)
    lengths, counts, gains, exposure = some_rays(model, 2, columns=5)
    if blind == "gain":
        gains[1] = 0
    else:
        exposure[:, 1] = 0
    counts[:, 1] = 0
    few = [0, 2, 3]
    keep = np.concatenate([np.arange(a, b) for c, (a, b) in enumerate(pairwise(model.starts)) if c in few])
    starts = np.array([0, 4, 8, 12])
    less = Transmission(model.columns[:, keep], model.weights[keep], starts)
    without = likelihood(lengths, MeasuredCounts(counts[:, few], gains[few], exposure[:, few]), less, 0.01)
    whole = likelihood(lengths, MeasuredCounts(counts, gains, exposure), model, 0.01)
    for found, right in zip(whole[:2], without[:2], strict=True):
        np.testing.assert_allclose(found, right, rtol=1e-12)


@pytest.mark.parametrize("scale", [50.0, 1000.0, -200.0])
def test_rays_without_photons_and_rays_that_amplify_give_finite_numbers(scale):
    model = spectral_model(2)
    lengths, counts, gains, exposure = some_rays(model, 2, columns=5)
    measured = MeasuredCounts(counts, gains, exposure)
    for values in likelihood(lengths * np.float32(scale), measured, model, 0.01, information=True):
        assert np.isfinite(values).all()


def test_any_number_of_threads_gives_the_same_bits():
    model = spectral_model(3)
    rays, results = some_rays(model, 3, views=5), []
    try:
        for threads in (1, 3):
            set_threads(threads)
            results.append(likelihood(rays[0], MeasuredCounts(*rays[1:]), model, 0.01, information=True))
    finally:
        set_threads(None)
    assert all(np.array_equal(a, b) for a, b in zip(*results, strict=True))


@pytest.mark.wrong_types
def test_line_integrals_of_other_views_are_refused():
    model = spectral_model(2)
    lengths, *rest = some_rays(model, 2, columns=5)
    with pytest.raises(InputError, match=r"\(2, 2, 3, 5\), got \(2, 1, 3, 5\)"):
        likelihood(lengths[:, :1], MeasuredCounts(*rest), model, 0.01)


@pytest.mark.parametrize("dispersion", [0.0, 0.02])
@pytest.mark.parametrize("parts", [0, 1])
def test_tensors_give_the_same_likelihood(dispersion, parts):
    """Also for a channel that a pixel or a view lacks, counts without photons, and weights."""
    bases, model = 3 - parts, spectral_model(3)
    lengths, counts, gains, exposure = some_rays(model, bases)
    rng = np.random.default_rng(4)
    gains[1, 0, 0], exposure[1, 2], counts[0, 0, 1], lengths[:, 0, 2, :3] = 0, 0, 0, 300
    profile = rng.uniform(0, 1, (parts, *gains.shape[1:])).astype(np.float32) if parts else None
    weights = rng.uniform(0, 1, counts.shape).astype(np.float32)
    measured = MeasuredCounts(counts, gains, exposure, profile, weights)
    wanted = likelihood(lengths, measured, model, dispersion, True)
    found = tensors.likelihood(torch.from_numpy(lengths), measured, model, dispersion, True)
    for ours, theirs in zip(found, wanted, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-6 * np.abs(theirs).max())
