"""Terms of the loss and the spectral model, each against something independent."""

import numpy as np
import pytest
import torch
from skimage.metrics import structural_similarity
from support.gaussian_scenes import random_gaussians

from phantomgen.dataset.spectral_model import Spectra
from phantomgen.geometry.voxel_grid import Grid
from recon.ops.voxelize import voxelize
from recon.published_methods.paper.learned_edge import ConditionedBasis, KEdge
from recon.published_methods.paper.loss import data_loss, patch_of_channels, random_patch, ssim, total_variation
from recon.published_methods.paper.spectral_model import SpectralModel, energy_grid
from spectra.basis.basis import Basis, BasisFunction
from spectra.errors import InputError
from spectra.transmission import Transmission

BASIS = Basis((BasisFunction("photoelectric"), BasisFunction("compton"), BasisFunction("sigmoid", 63.0, 0.5)))


def images(seed, shape=(1, 2, 24, 31)):
    return torch.from_numpy(np.random.default_rng(seed).uniform(size=shape))


def test_structural_similarity_is_that_of_scikit_image():
    """Five pixels off the border, where zeros outside and mirrored pixels do not differ."""
    one, other = images(1), images(2)
    found = ssim(one, other)
    for c in range(2):
        options = {"data_range": 1.0, "gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
        _, expected = structural_similarity(one[0, c].numpy(), other[0, c].numpy(), full=True, win_size=11, **options)
        np.testing.assert_allclose(found[0, c, 5:-5, 5:-5], expected[5:-5, 5:-5], rtol=1e-10)


def test_images_are_wholly_similar_to_themselves():
    torch.testing.assert_close(ssim(images(3), images(3)), torch.ones(1, 2, 24, 31, dtype=torch.float64))


def test_gradients_of_structural_similarity_are_finite_differences():
    one = images(4, (1, 1, 5, 6)).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: ssim(x, images(5, (1, 1, 5, 6))), one)


def test_data_loss_is_the_weighted_sum_over_channels():
    one, other = images(6), images(7)
    seen = torch.ones(one.shape, dtype=torch.bool)
    expected = sum(
        0.75 * abs(one[:, c] - other[:, c]).mean() + 0.25 * (1 - ssim(one, other)[:, c].mean()) for c in (0, 1)
    )
    torch.testing.assert_close(data_loss(one, other, seen, 0.25), expected)
    torch.testing.assert_close(data_loss(one, other, seen, 0.0), abs(one - other).mean(dim=(0, 2, 3)).sum())


def test_pixels_that_were_not_measured_do_not_count():
    one, other = images(8).requires_grad_(), images(9)
    seen = torch.ones(one.shape, dtype=torch.bool)
    seen[0, 0, 3:5] = False
    spoiled = torch.where(seen, other, 1e6)
    assert data_loss(one, other, seen, 0.25).item() == data_loss(one, spoiled, seen, 0.25).item()
    (gradient,) = torch.autograd.grad(data_loss(one, other, seen, 0.0), one)
    assert not gradient[~seen].any()
    assert gradient[seen].all()


def test_total_variation_of_a_ramp_is_its_slopes():
    z, y, x = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in (4, 5, 6)), indexing="ij")
    ramps = torch.stack([2 * x - 3 * y + z, torch.full_like(x, 7.0)])
    torch.testing.assert_close(total_variation(ramps), torch.tensor([6.0, 0.0], dtype=torch.float64))


def test_total_variation_counts_a_step_once_per_line():
    image = torch.zeros(1, 8, 9)
    image[:, :, 4:] = 2.0
    assert total_variation(image).item() == pytest.approx(2.0 / 8)
    assert total_variation(torch.ones(1, 1, 5)).item() == 0


def test_patches_lie_in_the_grid_and_reach_all_of_it():
    grid, rng = Grid((5, 40, 33), (1.0, 2.0, 0.5), (3.0, -4.0, 1.0)), np.random.default_rng(10)
    firsts = set()
    for _ in range(300):
        patch = random_patch(grid, 32, rng)
        assert (patch.shape, patch.spacing) == ((5, 32, 32), grid.spacing)
        firsts.add(tuple(round((p - o) / s) for p, o, s in zip(patch.origin, grid.origin, grid.spacing, strict=True)))
    assert firsts == {(0, y, x) for y in range(9) for x in range(2)}


@pytest.mark.parametrize("sigma", [(0.05, 0.3), (0.5, 2.0), (3.0, 8.0)])
def test_a_patch_of_channels_is_that_part_of_the_whole_volume(sigma):
    grid, means = Grid.cube(24, 24.0), torch.rand(4, 3, generator=torch.Generator().manual_seed(1))
    parts = [p.float() for p in random_gaussians(11, count=60, sigma=sigma, spread=12.0)]
    whole = np.einsum("cm,mzyx->czyx", means, voxelize(*parts, grid))
    patch = Grid((6, 7, 8), grid.spacing, (grid.origin[0] + 3, grid.origin[1] + 9, grid.origin[2] + 14))
    part = patch_of_channels(*parts, means, patch).numpy()
    np.testing.assert_allclose(part, whole[:, 3:9, 9:16, 14:22], atol=1e-6 * whole.max())


def spectra(channels=3):
    """Spectra with narrow and wide bins; the channels share them as a real detector does, not sharply."""
    rng, edges = np.random.default_rng(12), np.concatenate([np.linspace(18, 60, 30), np.linspace(61, 150, 40)])
    energy = (edges[:-1] + edges[1:]) / 2
    response = np.array([np.exp(-(((energy - centre) / 20) ** 2)) for centre in np.linspace(35, 110, channels)])
    values = BASIS.evaluate(energy)
    names = tuple(f"bin{c}" for c in range(channels))
    source = rng.uniform(1, 2, len(energy)) * 1e3
    return Spectra(energy, edges, source, response, BASIS, values, names, np.zeros(channels), np.ones(channels))


def conditioned(grid, edge=None, wanted=True):
    return ConditionedBasis(grid.energy, grid.signal, edge, wanted)


def test_photons_between_the_two_energies_are_kept():
    s = spectra()
    grid = energy_grid(s, 20.0, 140.0, 64)
    width = np.diff(s.edges)
    inside = np.clip(s.edges[1:], 20, 140) - np.clip(s.edges[:-1], 20, 140)
    np.testing.assert_allclose(grid.weights.sum(axis=1), s.weights @ (inside / width))
    np.testing.assert_allclose(grid.energy[[0, 63]], [20.9375, 139.0625])


def test_a_channel_outside_of_the_energies_is_refused():
    s = spectra()
    high = Spectra(**{**vars(s), "response": s.response * (s.energy > 140)})
    with pytest.raises(InputError, match="channel bin0 counts nothing between 20 and 140 keV"):
        energy_grid(high, 20.0, 140.0, 64)


@pytest.mark.parametrize("bases", [2, 3])
def test_log_projections_are_those_of_the_transmission(bases):
    grid = energy_grid(spectra(), 20.0, 140.0, 64)
    basis = conditioned(grid, KEdge.at(63.0, 2.0) if bases == 3 else None)
    lengths = np.random.default_rng(13).uniform(0, 1.5, (1, bases, 4, 5))
    found = SpectralModel(grid, basis).log_projections(torch.from_numpy(lengths).float())
    model = Transmission.from_spectrum(grid.weights, basis.columns(grid.energy).numpy())
    expected = np.moveaxis(model.log_projection(np.moveaxis(lengths, 1, -1)), -1, 1)
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_one_energy_per_channel_makes_log_projections_linear():
    grid = energy_grid(spectra(), 20.0, 140.0, 64)
    model = SpectralModel(grid.monochromatic(), conditioned(grid))
    lengths = torch.rand(1, 2, 3, 3)
    expected = torch.einsum("cm,vmij->vcij", model.channel_means(), lengths)
    torch.testing.assert_close(model.log_projections(lengths), expected, rtol=1e-5, atol=1e-6)


def test_a_bowtie_counts_as_more_material_of_which_the_open_beam_is_free():
    grid = energy_grid(spectra(), 20.0, 140.0, 64)
    filtered = type(grid)(grid.energy, grid.weights, np.linspace(0.5, 0.1, 64)[None])
    profile = np.random.default_rng(14).uniform(0, 3, (1, 4, 5))
    lengths = np.random.default_rng(15).uniform(0, 1.5, (1, 2, 4, 5))
    found = SpectralModel(filtered, conditioned(grid), profile).log_projections(torch.from_numpy(lengths).float())
    columns = np.concatenate([conditioned(grid).columns(grid.energy).numpy(), filtered.profile])
    model = Transmission.from_spectrum(grid.weights, columns)
    both = np.concatenate([lengths[0], profile])
    alone = np.concatenate([0 * lengths[0], profile])
    expected = model.log_projection(np.moveaxis(both, 0, -1)) - model.log_projection(np.moveaxis(alone, 0, -1))
    np.testing.assert_allclose(found[0], np.moveaxis(expected, -1, 0), rtol=1e-4, atol=1e-6)


def test_the_conditioned_edge_is_orthogonal_to_the_other_columns():
    grid = energy_grid(spectra(), 20.0, 140.0, 64)
    columns = conditioned(grid, KEdge.at(63.0, 2.0)).columns(grid.energy).numpy()
    gram = (columns * grid.signal / grid.signal.sum()) @ columns.T
    assert abs(gram[2, :2]).max() < 1e-12
    assert gram[2, 2] > 1e-3
    raw = conditioned(grid, KEdge.at(63.0, 2.0), wanted=False).columns(grid.energy).numpy()
    np.testing.assert_allclose(raw[2], BASIS.functions[2].evaluate(grid.energy))


@pytest.mark.parametrize("wanted", [True, False])
def test_raw_coefficients_attenuate_as_those_of_the_fit_do(wanted):
    """Exactly, as the learned edge is here one of the raw functions."""
    grid = energy_grid(spectra(), 20.0, 140.0, 64)
    basis, raw = conditioned(grid, KEdge.at(63.0, 2.0), wanted), BASIS.evaluate(grid.energy)
    own = np.random.default_rng(16).uniform(size=(7, 3))
    coefficients = own @ basis.to_raw(raw).numpy()
    np.testing.assert_allclose(coefficients @ raw, own @ basis.columns(grid.energy).numpy(), atol=1e-9)
    np.testing.assert_allclose(coefficients[:, 2], own[:, 2], rtol=1e-7)


def test_raw_coefficients_are_the_nearest_where_the_learned_edge_is_elsewhere():
    grid = energy_grid(spectra(), 20.0, 140.0, 64)
    basis, raw = conditioned(grid, KEdge.at(50.0, 1.0)), BASIS.evaluate(grid.energy)
    rest = basis.to_raw(raw).numpy() @ raw - basis.columns(grid.energy).numpy()
    assert abs(rest[:2]).max() < 1e-9
    assert abs((rest * grid.signal) @ raw.T).max() < 1e-9 * grid.signal.sum()
    assert abs(rest[2]).max() > 0.05


def test_gradients_of_the_edge_are_finite_differences():
    grid = energy_grid(spectra(), 20.0, 140.0, 64)
    edge = KEdge.at(63.0, 0.7)

    def columns(*parameters):
        return conditioned(grid, KEdge(*parameters)).columns(grid.energy)

    assert torch.autograd.gradcheck(columns, tuple(p.requires_grad_() for p in edge.tensors()))
