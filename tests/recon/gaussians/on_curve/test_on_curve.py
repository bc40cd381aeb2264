"""Gaussians on a curve of materials: directions, steps along them, and what a fit gains at metal."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import binary_dilation, binary_erosion
from support.one_channel_scans import ROD, WATER, one_channel_scan

from phantomgen.dataset.truth import read_truth
from phantomgen.geometry.voxel_grid import Grid
from recon.data.measurements import read_measurements
from recon.gaussians.divided.model import DividedGaussians
from recon.gaussians.initial.first_guess import start_method
from recon.gaussians.on_curve.directions import AlongCurve, along
from recon.gaussians.on_curve.information import mean_information
from recon.gaussians.recipe import FAST, PLAIN_FAST, with_residual_in_voxels
from recon.gaussians.reconstruct import reconstruct
from recon.kedge.basis_names import OnCurve
from recon.voxel.iterative.one_step import OneStep
from spectra.errors import InputError
from spectra.materials.material_curve import MaterialCurve

ROWS = ((0.004, 0.015), (0.006, 0.016), (0.09, 0.03))
AT = 0.3, 0.9  # basis functions at the energy of the curve
FAT, _, METAL = ATTENUATIONS = tuple(AT[0] * p + AT[1] * c for p, c in ROWS)
CURVE = MaterialCurve(("fat", "water", "metal"), ATTENUATIONS, ROWS)
GRID = Grid((10, 10, 10), (1.0, 1.0, 1.0), (-4.5, -4.5, -4.5))


@given(st.floats(0, 0.2))
def test_attenuation_of_coefficients_is_the_inverse_of_the_curve(attenuation):
    value = np.array([attenuation])
    assert CURVE.attenuation_of(CURVE.values(value)) == pytest.approx(value, abs=1e-12)


def two_sides(offset):
    """One Gaussian in the middle, whose third axis is x, and its plane."""
    half = np.sqrt(0.5)
    return DividedGaussians(
        torch.zeros(1, 3), torch.zeros(1, 3), torch.tensor([[half, 0, half, 0]]).float(), torch.tensor([offset]),
        torch.ones(1, 2, 2), ("photoelectric", "compton"), 0.25,
    )  # fmt: skip


def test_either_side_of_a_plane_has_its_material():
    values = np.full(GRID.shape, FAT)
    values[:, :, 5:] = METAL  # where x > 0
    found = AlongCurve(CURVE, values, GRID).directions(two_sides(0.0)).numpy()[0]
    assert found == pytest.approx(np.array([ROWS[0], ROWS[2]]) / [[FAT], [METAL]], rel=1e-5)


def test_both_sides_are_where_the_centre_is_without_a_plane():
    values = np.full(GRID.shape, FAT)
    values[:, :, 5:] = METAL
    first, second = AlongCurve(CURVE, values, GRID).directions(two_sides(9.0)).numpy()[0]
    assert first == pytest.approx(second)


def test_a_step_along_a_direction_ends_at_the_minimum_on_its_line():
    random = np.random.default_rng(0)
    root = random.normal(size=(5, 2, 3, 3))
    curvature = torch.from_numpy(root @ root.swapaxes(-1, -2))
    directions, gradient = (torch.from_numpy(random.normal(size=(5, 2, 3))) for _ in range(2))
    step = -torch.einsum("gsmn,gsn->gsm", along(curvature, directions), gradient)
    assert np.cross(step, directions) == pytest.approx(0, abs=1e-9)
    slope = gradient + torch.einsum("gsmn,gsn->gsm", curvature, step)
    assert (slope * directions).sum(dim=-1).numpy() == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize(
    "recipe",
    [PLAIN_FAST, replace(FAST, prior=0.0), with_residual_in_voxels(FAST)],
    ids=["plain", "no prior", "residual"],
)
def test_recipes_that_take_no_curve_are_refused(recipe):
    with pytest.raises(InputError, match="Gaussians on a curve of materials need"):
        replace(recipe, curve=CURVE)


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """Water with a rod of titanium, and one channel: the fit, the truth, and the curve."""
    path = tmp_path_factory.mktemp("on-curve") / "rod.h5"
    small = {"panel": {"rows": 48, "columns": 60, "pitch": 3}, "volume": {"voxels": 32, "size": 80}}
    with one_channel_scan(path, WATER, ROD, **small) as dataset:
        curve = OnCurve(("water", "Ti")).curve(dataset)
        return reconstruct(dataset, replace(FAST, curve=curve)), read_truth(path).volumes, curve


def test_the_fit_is_better_than_the_voxels_that_it_began_with(fitted):
    result, true, curve = fitted
    start, end = (curve.attenuation_of(v - true) for v in (result.initial_volumes, result.volumes))
    assert np.square(end).mean() < np.square(start).mean()
    beside = binary_dilation(curve.attenuation_of(true) > 0.06, iterations=3) & (curve.attenuation_of(true) < 0.03)
    assert np.square(end[beside]).mean() < 0.7 * np.square(start[beside]).mean()


def test_both_bases_follow_from_one_channel_away_from_edges(fitted):
    result, true, curve = fitted
    water = binary_erosion(np.isclose(true[1], curve.coefficients[0][1], rtol=1e-3), iterations=2)
    assert water.sum() > 1000
    means = result.volumes[:, water].mean(axis=1)
    assert means == pytest.approx(np.array(curve.coefficients[0]), rel=0.02, abs=3e-4)


def test_the_start_is_on_the_curve_and_information_of_one_channel_can_be_inverted(tmp_path):
    with one_channel_scan(tmp_path / "water.h5", WATER, noise=False) as dataset:
        curve = OnCurve().curve(dataset)
        measured = read_measurements(dataset, dataset.splits["train"][:2], separable=False)
        method = start_method(measured, dataset.grid, replace(FAST, curve=CURVE))
    found = mean_information(measured.binned(4), curve, 0.0)
    assert isinstance(method, OneStep)
    assert method.curve is CURVE
    values, vectors = np.linalg.eigh(found)
    assert values[0] > 0
    assert values[0] < 0.02 * values[1]
    assert (vectors[:, 1] * vectors[0, 1] > 0).all()  # more of either basis attenuates
