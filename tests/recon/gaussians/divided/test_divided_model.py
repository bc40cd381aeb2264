"""Gaussians that planes divide: their volumes, line integrals, files, and their description by plain Gaussians."""

import numpy as np
import pytest
import torch
from scipy.special import ndtr

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.divided.model import DividedGaussians
from recon.gaussians.divided.model_file import load_model
from recon.gaussians.model import Gaussians
from spectra.errors import DatasetError

GRID = Grid.cube(24, 24.0)
NAMES = ("photoelectric", "compton")


def divided(count: int = 6, seed: int = 1, width: float = 0.1) -> DividedGaussians:
    random = np.random.default_rng(seed)
    parts = (
        random.uniform(-5, 5, (count, 3)), np.log(random.uniform(1.5, 3, (count, 3))), random.normal(size=(count, 4)),
        random.normal(0, 1, count), random.uniform(0.01, 0.05, (count, 2, 2)),
    )  # fmt: skip
    return DividedGaussians(*(torch.from_numpy(part).float() for part in parts), NAMES, width)


def sampled(model: DividedGaussians, grid: Grid, finer: int) -> np.ndarray:
    """Means over voxels of the model's formula, at many points of each voxel."""
    at = [
        grid.origin[k] + (np.arange(grid.shape[k] * finer) + 0.5) / finer * grid.spacing[k] - grid.spacing[k] / 2
        for k in (2, 1, 0)
    ]
    z, y, x = np.meshgrid(*at[::-1], indexing="ij")
    points = np.stack([x, y, z], axis=-1)
    total = np.zeros((2, *z.shape))
    for p, s, q, offset, (low, high) in zip(*(part.double().numpy() for part in model.tensors().values()), strict=True):
        w, i, j, k = q / np.linalg.norm(q)
        turned = np.array(
            [
                [1 - 2 * (j * j + k * k), 2 * (i * j - w * k), 2 * (i * k + w * j)],
                [2 * (i * j + w * k), 1 - 2 * (i * i + k * k), 2 * (j * k - w * i)],
                [2 * (i * k - w * j), 2 * (j * k + w * i), 1 - 2 * (i * i + j * j)],
            ]
        )
        own = (points - p) @ turned
        height = np.exp(-0.5 * ((own / np.exp(s)) ** 2).sum(axis=-1))
        part = ndtr((own[..., 2] - offset) / model.width)
        total += height * (low[:, None, None, None] + (high - low)[:, None, None, None] * part)
    n = finer
    depth, rows, columns = grid.shape
    return total.reshape(2, depth, n, rows, n, columns, n).mean(axis=(2, 4, 6))


def test_voxels_hold_means_of_the_formula():
    model, grid = divided(), Grid.cube(12, 12.0)
    wanted = sampled(model, grid, 8)
    assert np.abs(model.volume(grid) - wanted).max() < 0.01 * wanted.max()


def test_a_part_of_a_grid_has_the_values_of_the_whole():
    model = divided()
    np.testing.assert_allclose(model.volume(GRID)[:, 5:9], model.volume(GRID.slices(5, 4)), atol=1e-7)


def test_voxels_are_not_negative_though_coefficients_are():
    model = divided()
    dug = model.with_values(-model.coefficients)
    assert dug.volume(GRID).min() == 0
    assert float(dug.voxels(GRID).min()) < 0


def test_line_integrals_add_up_to_the_mass_of_the_voxels():
    model = divided()
    geometry = Geometry.circular(1e6, 2e6, np.array([0.4]), Panel(48, 48, 2.0))
    seen = model.line_integrals(geometry).sum(dim=(0, 2, 3)).numpy()
    np.testing.assert_allclose(seen, model.volume(Grid.cube(48, 48.0)).sum(axis=(1, 2, 3)), rtol=2e-3)


def test_plain_gaussians_have_the_mass_centre_and_covariance_of_the_sides():
    model, grid = divided(1, seed=3, width=1e-3), Grid.cube(60, 30.0)
    plain = model.plain()
    assert len(plain) == 2

    def moments(volume):
        mass = volume.sum()
        points = np.stack(np.meshgrid(*(grid.axis(name) for name in "zyx"), indexing="ij"), axis=-1)
        mean = (points * volume[..., None]).sum(axis=(0, 1, 2)) / mass
        away = points - mean
        return mass, mean, np.einsum("zyx,zyxi,zyxj->ij", volume, away, away) / mass

    for side in (0, 1):
        values = torch.zeros_like(model.coefficients)
        values[:, side] = model.coefficients[:, side]
        wanted = moments(model.with_values(values).volume(grid)[0].astype(float))
        found = moments(plain.part(torch.tensor([side])).volume(grid)[0].astype(float))
        assert found[0] == pytest.approx(wanted[0], rel=0.01)
        np.testing.assert_allclose(found[1], wanted[1], atol=0.05)
        np.testing.assert_allclose(found[2], wanted[2], atol=0.1)


def test_a_plane_far_away_divides_nothing_and_costs_no_numbers():
    model = divided()
    far = model.with_tensors({"offsets": torch.full((6,), -100.0)})
    same = Gaussians(*(model.tensors()[n] for n in Gaussians.GEOMETRY), model.coefficients[:, 1], NAMES)
    np.testing.assert_allclose(far.voxels(GRID).numpy(), same.voxels(GRID, 4.0).numpy(), rtol=1e-3, atol=1e-6)
    assert far.numbers == same.numbers == 6 * 12
    assert model.numbers == 6 * 15


def test_a_file_gives_the_same_model(tmp_path):
    model = divided()
    model.save(tmp_path / "model.safetensors")
    found = load_model(tmp_path / "model.safetensors")
    assert isinstance(found, DividedGaussians)
    assert (found.width, found.basis_names) == (model.width, NAMES)
    assert all(torch.equal(a, b) for a, b in zip(found.tensors().values(), model.tensors().values(), strict=True))


def test_a_reader_of_plain_gaussians_says_what_the_file_is(tmp_path):
    divided().save(tmp_path / "model.safetensors")
    with pytest.raises(DatasetError, match=r"written as 'spectral-ct divided gaussians 1\.0'"):
        Gaussians.load(tmp_path / "model.safetensors")
