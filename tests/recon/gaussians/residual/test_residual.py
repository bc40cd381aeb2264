"""A residual in voxels: what it holds, its file, and that it takes what Gaussians leave unexplained, and no noise."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from support.gaussian_scenes import PIXEL, circular, small_model, small_scan, spectral_model

from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.divided.model_file import load_model
from recon.gaussians.recipe import FAST, with_residual_in_voxels
from recon.gaussians.residual.fit_residual import as_voxels_project, with_residual
from recon.gaussians.residual.model import GaussiansWithResidual
from recon.gaussians.settings import ResidualSettings
from recon.gaussians.unseen_rays import UnseenRays, with_unseen_rays
from recon.voxel.iterative.likelihood import deviance_and_gradient
from recon.voxel.model import Voxels
from spectra.errors import DatasetError, InputError

GRID = Grid.cube(24, 24.0)
SETTINGS = ResidualSettings(passes=4)
BALL = 0.02  # coefficients of the first basis in a ball that no Gaussian knows [1/mm]


def ball() -> np.ndarray:
    """A ball beside the centre, in the first of three bases."""
    z, y, x = np.meshgrid(*(GRID.axis(name) for name in "zyx"), indexing="ij")
    inside = (x - 3) ** 2 + y**2 + z**2 < 3.2**2
    return np.stack([BALL * inside, 0 * x, 0 * x]).astype(np.float32)


def together(model, values: np.ndarray) -> GaussiansWithResidual:
    """A model with a residual of these values."""
    places = np.flatnonzero(values.any(axis=0))
    added = np.ascontiguousarray(values.reshape(len(values), -1)[:, places].T)
    return GaussiansWithResidual(model, torch.from_numpy(places), torch.from_numpy(added), GRID)


@pytest.fixture(scope="module")
def found():
    """Gaussians; a scan of them and of a ball; the residual that the scan gives."""
    gaussians = small_model(1)
    measured = small_scan(
        together(gaussians, ball()), circular(32, 32, views=24), spectral_model(3, photons=1e6), seed=3
    )
    measured = with_unseen_rays(measured, PIXEL / 2, seed=0)
    return gaussians, measured, with_residual(gaussians, measured, GRID, SETTINGS)


def test_volumes_and_line_integrals_are_sums_of_both_parts():
    gaussians = small_model(1)
    model, geometry = together(gaussians, ball()), circular(8, 8, views=3)
    names = gaussians.basis_names
    assert model.volume(GRID) == pytest.approx(gaussians.volume(GRID) + ball(), abs=1e-7)
    parts = gaussians.line_integrals(geometry) + Voxels(ball(), GRID, names).line_integrals(geometry)
    assert model.line_integrals(geometry).numpy() == pytest.approx(parts.numpy(), abs=1e-6)
    assert model.voxels(GRID).numpy() == pytest.approx(gaussians.voxels(GRID).numpy() + ball(), abs=1e-7)


def test_volumes_are_not_negative():
    assert together(small_model(1), -10 * ball()).volume(GRID).min() == 0


def test_numbers_are_those_of_gaussians_and_of_the_voxels_that_hold_something():
    gaussians, voxels = small_model(1), int(ball().any(axis=0).sum())
    assert together(gaussians, ball()).numbers == gaussians.numbers + voxels * (1 + 3)


def test_a_file_gives_the_same_model(tmp_path):
    model = together(small_model(1), ball())
    model.save(tmp_path / "a.safetensors")
    again = load_model(tmp_path / "a.safetensors")
    assert isinstance(again, GaussiansWithResidual)
    assert again.grid == GRID
    assert all(torch.equal(one, again.tensors()[name]) for name, one in model.tensors().items())
    assert repr(again) == repr(model)


@pytest.mark.parametrize(
    ("spoilt", "said"),
    [
        ({"places": torch.tensor([24**3])}, "outside of its grid"),
        ({"places": torch.tensor([-1])}, "outside of its grid"),
        ({"places": torch.tensor([1, 2])}, "residual has shape"),
        ({"places": torch.tensor([1.0])}, "expected whole numbers"),
        ({"residual": torch.full((1, 3), torch.nan)}, "not a number"),
    ],
)
def test_a_damaged_residual_is_refused(tmp_path, spoilt, said):
    one = together(small_model(1), ball())
    parts = {"places": torch.tensor([5]), "residual": torch.ones(1, 3)} | spoilt
    object.__setattr__(one, "tensors", lambda: one.gaussians.tensors() | parts)
    one.save(tmp_path / "a.safetensors")
    with pytest.raises(DatasetError, match=said):
        load_model(tmp_path / "a.safetensors")


def test_other_arrays_and_devices_keep_both_parts():
    model = together(small_model(1), ball())
    moved = model.with_tensors({"centres": model.centres + 1})
    assert torch.equal(moved.centres, model.centres + 1)
    assert torch.equal(moved.residual, model.residual)
    assert torch.equal(model.to("cpu").detached().places, model.places)
    assert len(model.part(torch.tensor([0, 2]))) == 2
    assert len(model.plain()) == len(model.gaussians)


def test_counts_of_a_true_model_agree_with_its_volumes_after_the_correction():
    """Exact counts of Gaussians, corrected, are those that their voxels expect: the deviance vanishes."""
    gaussians = small_model(1)
    measured = small_scan(gaussians, circular(32, 32, views=6), spectral_model(3))
    volumes = gaussians.volume(GRID)
    corrected = as_voxels_project(measured, 2, gaussians, Voxels(volumes, GRID, gaussians.basis_names))
    before, after = (deviance_and_gradient(volumes, data, GRID, 0.0)[0] for data in (measured.binned(2), corrected))
    assert after < 1e-6 * before


def test_voxels_take_what_gaussians_leave(found):
    gaussians, _, model = found
    added = model.volume(GRID) - gaussians.volume(GRID)
    error, before = np.abs(added - ball())[0].sum(), np.abs(ball())[0].sum()
    assert error < 0.5 * before
    assert added[0][ball()[0] > 0].mean() == pytest.approx(BALL, rel=0.25)


def test_rays_that_took_no_part_confirm_it(found):
    gaussians, measured, model = found
    rays = UnseenRays.of(measured, PIXEL / 2, 0.02)
    kept, notes = rays.with_or_without(model, gaussians, SETTINGS.worth)
    assert kept is model
    assert "a residual is kept in" in notes[0]


def test_noise_is_left_out():
    gaussians = small_model(1)
    measured = small_scan(gaussians, circular(32, 32, views=24), spectral_model(3), seed=3)
    measured = with_unseen_rays(measured, PIXEL / 2, seed=0)
    model, loose = (with_residual(gaussians, measured, GRID, replace(SETTINGS, strength=s)) for s in (0.5, 0.01))
    assert model.residual.square().sum() < 0.25 * loose.residual.square().sum()
    kept, notes = UnseenRays.of(measured, PIXEL / 2, 0.02).with_or_without(model, gaussians, SETTINGS.worth)
    assert kept is gaussians
    assert "is left out" in notes[0]


def test_a_residual_that_is_not_worth_its_numbers_is_left_out(found):
    gaussians, measured, model = found
    kept, notes = UnseenRays.of(measured, PIXEL / 2, 0.02).with_or_without(model, gaussians, 1e6)
    assert kept is gaussians
    assert "is left out" in notes[0]


def test_passes_are_a_number():
    assert with_residual_in_voxels(FAST).residual.passes > 0
    with pytest.raises(InputError, match="recipe residual passes"):
        replace(SETTINGS, passes=-1)
