import os

import numpy as np
import pytest
import torch

from recon.ops.nonnegative_newton import as_matrices, inverse_blocks, nonnegative_newton_step
from recon.ops.nonnegative_newton.reference import nonnegative_newton_step as reference
from spectra.threads import set_threads

DEVICE = "cuda" if os.environ["TRITON_INTERPRET"] == "0" else "cpu"


def some_voxels(bases, count=300, seed=1):
    """Volumes, upper triangles of inverse blocks, cotangents, and the blocks as matrices."""
    rng = np.random.default_rng(seed)
    roots = rng.normal(size=(count, bases, bases)) + 0.3 * np.eye(bases)
    blocks = roots @ roots.transpose(0, 2, 1) + 0.05 * np.eye(bases)
    inverse = np.linalg.inv(blocks)
    upper = np.triu_indices(bases)
    triangles = inverse[:, *upper].T.reshape(-1, 1, 1, count)
    volumes, cotangents = (rng.normal(size=(bases, 1, 1, count)) for _ in range(2))
    return *(a.astype(np.float32) for a in (volumes, triangles, cotangents)), blocks


@pytest.mark.parametrize("bases", [1, 2, 3, 4])
def test_steps_end_where_the_best_set_of_zeros_is(bases):
    volumes, inverse, cotangents, _ = some_voxels(bases)
    found = nonnegative_newton_step(volumes, inverse, cotangents).reshape(bases, -1)
    matrices = as_matrices(inverse).reshape(-1, bases, bases).astype(float)
    columns = zip(volumes.reshape(bases, -1).T, matrices, cotangents.reshape(bases, -1).T, strict=True)
    right = np.array([reference(x.astype(float), h, p.astype(float)) for x, h, p in columns]).T
    np.testing.assert_allclose(found, right, atol=2e-4 * np.abs(right).max())


@pytest.mark.parametrize("bounded", [True, False])
@pytest.mark.parametrize("bases", [1, 2, 3, 4])
def test_tensors_end_at_the_same_points(bases, bounded):
    pytest.importorskip("triton")
    arrays = some_voxels(bases)[:3]
    found = nonnegative_newton_step(*(torch.from_numpy(part).to(DEVICE) for part in arrays), bounded)
    np.testing.assert_allclose(found.cpu(), nonnegative_newton_step(*arrays, bounded), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("bases", [1, 3])
def test_without_the_bound_it_is_a_newton_step(bases):
    volumes, inverse, cotangents, blocks = some_voxels(bases)
    found = nonnegative_newton_step(volumes, inverse, cotangents, bounded=False).reshape(bases, -1)
    step = np.linalg.solve(blocks, cotangents.reshape(bases, -1).T[:, :, None])[:, :, 0].T
    np.testing.assert_allclose(found, volumes.reshape(bases, -1) - step, atol=1e-4 * np.abs(step).max())


@pytest.mark.parametrize("bases", [1, 2, 3, 4])
def test_inverse_blocks_times_blocks_are_one(bases):
    *_, blocks = some_voxels(bases)
    upper = np.triu_indices(bases)
    triangles = blocks[:, *upper].T.reshape(-1, 1, 1, len(blocks))
    floor = np.linspace(0.1, 0.2, bases)
    found = as_matrices(inverse_blocks(triangles, floor)).reshape(-1, bases, bases)
    products = found @ (blocks + np.diag(floor))
    np.testing.assert_allclose(products, np.broadcast_to(np.eye(bases), products.shape), atol=1e-4)


def test_a_voxel_that_no_ray_meets_keeps_a_finite_inverse():
    assert np.isfinite(inverse_blocks(np.zeros((6, 1, 1, 2)), np.full(3, 1e-6))).all()


def test_any_number_of_threads_gives_the_same_bits(monkeypatch):
    monkeypatch.setattr("recon.ops.nonnegative_newton.CHUNK", 16)
    results = []
    try:
        for threads in (1, 3):
            set_threads(threads)
            results.append(nonnegative_newton_step(*some_voxels(3)[:3]))
    finally:
        set_threads(None)
    assert np.array_equal(*results)
