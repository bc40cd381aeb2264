"""Scores of a finished fit: against the truth where a dataset has one, against its test views always."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.truth import Truth
from phantomgen.geometry.voxel_grid import Grid
from recon.data.measurements import Measurements, read_measurements
from recon.evaluation.metrics import (
    HeldOutView,
    psnr,
    score_basis_volumes,
    score_elsewhere,
    score_materials,
    score_projections,
)
from recon.gaussians.model import Gaussians
from recon.voxel.model import Voxels
from recon.voxel.unreliable import Unreliable

FULL_FRACTION = 65535  # as the truth stores a voxel that one material fills
VIEWS_AT_ONCE = 2


def held_out_views(
    dataset: Dataset, model: Gaussians | Voxels, unreliable: Unreliable | None = None
) -> Iterator[HeldOutView]:
    """Test views of a dataset and what the model expects there, in order; rays through unreliable voxels are marked."""
    test = dataset.splits["test"]
    for first in range(0, len(test), VIEWS_AT_ONCE):
        views = test[first : first + VIEWS_AT_ONCE]
        measured = read_measurements(dataset, views, len(model.basis_names))
        yield from _predict(measured, model, unreliable)


def _predict(measured: Measurements, model: Gaussians | Voxels, unreliable: Unreliable | None) -> Iterator[HeldOutView]:
    lengths = model.line_integrals(measured.geometry).numpy()
    lengths = measured.with_profile(np.moveaxis(lengths, 1, -1))
    expected = np.moveaxis(measured.transmission.expected(lengths), -1, 1)
    open_beam = measured.gains * measured.open_beam
    marked = None if unreliable is None else _rays_through(unreliable, measured)
    for view, (counts, exposure) in enumerate(zip(measured.counts, measured.exposure, strict=True)):
        scale = exposure[:, None, None]
        through = None if marked is None else marked[view]
        yield HeldOutView.of(counts, expected[view] * measured.gains * scale, open_beam * scale, marked=through)


def _rays_through(unreliable: Unreliable, measured: Measurements) -> Bool[np.ndarray, "view row column"]:
    """Rays that lie in marked voxels for more than half the edge of one."""
    one = Voxels(unreliable.marked[None].astype(np.float32), unreliable.grid, ("marked",))
    return one.line_integrals(measured.geometry).numpy()[:, 0] > 0.5 * min(unreliable.grid.spacing)


def score_test_views(
    dataset: Dataset, model: Gaussians | Voxels, unreliable: Unreliable | None = None
) -> dict[str, Any]:
    """Per channel: PSNR of log projections and chi-square, see `recon.evaluation.metrics.score_projections`."""
    return score_projections(held_out_views(dataset, model, unreliable), dataset.spectra.channels)


def score_truth(truth: Truth, model: Gaussians | Voxels, unreliable: Unreliable | None = None) -> dict[str, Any]:
    """Per basis and per material, on the grid and in the basis of the truth; also without unreliable voxels.

    A basis that the model lacks is scored as a volume of zeros.
    """
    volumes = _in_basis_of(truth, model.volume(truth.grid), model.basis_names)
    materials = score_materials(
        volumes, truth.fractions, truth.coefficients, truth.material_names, truth.basis_names, FULL_FRACTION
    )
    basis = score_basis_volumes(volumes, truth.volumes, truth.basis_names)
    if unreliable is not None and unreliable.grid == truth.grid:
        elsewhere = score_elsewhere(volumes, truth.volumes, truth.basis_names, unreliable.marked)
        basis = {name: scores | elsewhere[name] for name, scores in basis.items()}
    return {"basis": basis, **materials}


def psnr_of_bases(truth: Truth, model: Gaussians | Voxels) -> dict[str, float]:
    """PSNR of each basis [dB] as ``psnr_<name>``, of those that the model and the truth have."""
    scores = {}
    for name, volume in zip(model.basis_names, model.volume(truth.grid), strict=True):
        if name not in truth.basis_names:
            continue
        true = truth.volumes[truth.basis_names.index(name)]
        value = psnr(float(true.max()), float(np.mean((volume - true) ** 2)))
        if value is not None:
            scores[f"psnr_{name}"] = value
    return scores


def score_start(
    method: str, truth: Truth, volumes: Float[np.ndarray, "basis z y x"], names: tuple[str, ...], grid: Grid
) -> dict[str, Any]:
    """Scores per basis of what `method` made a fit start from; empty on another grid than that of the truth."""
    if grid != truth.grid:
        return {}
    return {method: score_basis_volumes(_in_basis_of(truth, volumes, names), truth.volumes, truth.basis_names)}


def _in_basis_of(
    truth: Truth, volumes: Float[np.ndarray, "basis z y x"], names: tuple[str, ...]
) -> Float[np.ndarray, "basis z y x"]:
    """Volumes in the order of the truth's basis functions, zeros for those that are missing."""
    out = np.zeros((len(truth.basis_names), *truth.grid.shape), np.float32)
    for name, volume in zip(names, volumes, strict=True):
        if name in truth.basis_names:
            out[truth.basis_names.index(name)] = volume
    return out
