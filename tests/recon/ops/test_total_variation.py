import os

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from support.tolerances import TOLERANCES

from phantomgen.geometry.voxel_grid import Grid
from recon.ops.total_variation import ascend, gradient, neighbour_sums, total_variation
from recon.ops.total_variation.reference import differences
from recon.ops.total_variation.reference import total_variation as reference
from spectra.threads import set_threads

DEVICE = "cuda" if os.environ["TRITON_INTERPRET"] == "0" else "cpu"
SHAPES = [(1, 1, 1), (5, 1, 7), (6, 5, 4)]


def some_problem(shape=(6, 5, 4), bases=3, seed=1):
    rng = np.random.default_rng(seed)
    grid = Grid(shape, (1.0, 2.0, 1.5), (0.0, 0.0, 0.0))
    volumes = rng.normal(size=(bases, *shape)).astype(np.float32)
    return volumes, rng.normal(size=(bases, bases)), grid


def scales_of(grid):
    return [min(grid.spacing) / s for s in grid.spacing]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("bases", [1, 3])
def test_value_is_that_of_the_formula(shape, bases):
    volumes, mixing, grid = some_problem(shape, bases)
    right = reference(torch.tensor(volumes).double(), torch.tensor(mixing), scales_of(grid)).item()
    assert total_variation(volumes, mixing, grid) == pytest.approx(right, rel=TOLERANCES["total_variation"], abs=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("bases", [1, 3])
def test_tensors_give_the_same_steps(shape, bases):
    pytest.importorskip("triton")
    volumes, mixing, grid = some_problem(shape, bases)
    rng, mixing = np.random.default_rng(3), mixing.T  # columns first in memory
    field = rng.normal(size=(3, *volumes.shape)).astype(np.float32)
    steps, radii = rng.uniform(0, 1, (2, *shape)).astype(np.float32)
    radii[0, 0, 0] = 0
    tensors = [torch.from_numpy(part.copy()).to(DEVICE) for part in (field, volumes, steps, radii)]
    ascend(field, volumes, mixing, grid, steps, radii)
    ascend(tensors[0], tensors[1], mixing, grid, *tensors[2:])
    np.testing.assert_allclose(tensors[0].cpu(), field, rtol=1e-5, atol=1e-6)
    found = gradient(tensors[0], mixing, grid).cpu()
    np.testing.assert_allclose(found, gradient(field, mixing, grid), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("bases", [1, 3])
def test_ascending_from_zero_without_bound_gives_mixed_differences(shape, bases):
    volumes, mixing, grid = some_problem(shape, bases)
    field, steps = np.zeros((3, *volumes.shape), np.float32), np.full(shape, 0.5, np.float32)
    ascend(field, volumes, mixing, grid, steps, np.full(shape, 1e6))
    right = 0.5 * np.einsum("mn,anzyx->amzyx", mixing, differences(torch.tensor(volumes), scales_of(grid)))
    np.testing.assert_allclose(field, right, atol=1e-5)


@given(seed=st.integers(0, 999), bases=st.integers(1, 4), shape=st.tuples(*[st.integers(1, 9)] * 3))
@settings(deadline=None, max_examples=30)
def test_pull_is_the_transpose_of_mixed_differences(seed, bases, shape):
    volumes, mixing, grid = some_problem(shape, bases, seed)
    field = np.random.default_rng(seed + 1).normal(size=(3, *volumes.shape)).astype(np.float32)
    mixed = np.einsum("mn,anzyx->amzyx", mixing, differences(torch.tensor(volumes).double(), scales_of(grid)))
    one, other = np.vdot(mixed, field), np.vdot(volumes.astype(float), gradient(field, mixing, grid))
    size = np.linalg.norm(mixed) * np.linalg.norm(field)
    assert abs(one - other) <= TOLERANCES["total_variation"] * size


def test_the_field_that_ascent_finds_attains_the_total_variation():
    """TV(x) = max <p, W D x> over |p| <= 1."""
    volumes, mixing, grid = some_problem()
    field = np.zeros((3, *volumes.shape), np.float32)
    ascend(field, volumes, mixing, grid, np.full(grid.shape, 1e6), np.ones(grid.shape))
    assert np.sqrt((field.astype(float) ** 2).sum(axis=(0, 1))).max() <= 1 + 1e-6
    attained = np.vdot(gradient(field, mixing, grid), volumes)
    assert attained == pytest.approx(total_variation(volumes, mixing, grid), rel=1e-4)


def test_a_radius_of_zero_ends_the_field():
    volumes, mixing, grid = some_problem()
    field = np.ones((3, *volumes.shape), np.float32)
    ascend(field, volumes, mixing, grid, np.ones(grid.shape), np.zeros(grid.shape))
    assert not field.any()


def test_each_voxel_has_its_own_radius():
    volumes, mixing, grid = some_problem()
    field, radii = np.zeros((3, *volumes.shape), np.float32), np.random.default_rng(1).uniform(0.1, 2, grid.shape)
    ascend(field, volumes, mixing, grid, np.full(grid.shape, 1e6), radii)
    lengths = np.sqrt((field.astype(float) ** 2).sum(axis=(0, 1)))
    np.testing.assert_allclose(lengths[:-1, :-1, :-1], radii[:-1, :-1, :-1], rtol=1e-5)


def test_constant_volumes_have_none():
    _, mixing, grid = some_problem()
    assert total_variation(np.full((3, *grid.shape), 7.0), mixing, grid) == 0


@given(seed=st.integers(0, 999), shape=st.tuples(*[st.integers(1, 6)] * 3))
@settings(deadline=None, max_examples=30)
def test_neighbour_sums_bound_the_pull(seed, shape):
    rng = np.random.default_rng(seed)
    _, _, grid = some_problem(shape, 1)
    values = rng.uniform(0, 3, shape).astype(np.float32)
    field = rng.normal(size=(3, 1, *shape)).astype(np.float32)
    pulled = (values * gradient(field, np.eye(1), grid)[0].astype(float) ** 2).sum()
    assert pulled <= (neighbour_sums(values, grid) * (field[:, 0].astype(float) ** 2).sum(axis=0)).sum() * (1 + 1e-6)


def test_any_number_of_threads_gives_the_same_bits():
    volumes, mixing, grid = some_problem((13, 6, 7))
    results = []
    try:
        for threads in (1, 3):
            set_threads(threads)
            field = np.zeros((3, *volumes.shape), np.float32)
            ascend(field, volumes, mixing, grid, np.ones(grid.shape), np.ones(grid.shape))
            results.append((field, gradient(field, mixing, grid), total_variation(volumes, mixing, grid)))
    finally:
        set_threads(None)
    assert all(np.array_equal(a, b) for a, b in zip(*results, strict=True))
