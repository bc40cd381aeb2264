"""Scores of a finished fit: against the truth where a dataset has one, against its test views in any case."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, Real

from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.truth import Truth
from phantomgen.geometry.voxel_grid import Grid
from recon.data.measurements import Measurements, read_measurements
from recon.data.view_subsets import evenly_spread_views, view_groups
from recon.evaluation.count_noise import CountNoise
from recon.evaluation.metrics import (
    HeldOutView,
    psnr,
    score_basis_volumes,
    score_elsewhere,
    score_materials,
    score_projections,
)
from recon.gaussians.model import GaussianModel
from recon.voxel.model import Voxels
from recon.voxel.unreliable import Unreliable
from spectra.errors import InputError
from spectra.threads import run_parallel

FULL_FRACTION = 65535  # value of a voxel that one material fills, in the truth of a dataset
VIEWS_AT_ONCE = 2  # views; predicted together, which bounds the memory
FITTED_VIEWS = 8  # views; of those of a fit, compared with its prediction where there are no test views


def held_out_views(
    dataset: Dataset, model: GaussianModel | Voxels, unreliable: Unreliable | None = None
) -> Iterator[HeldOutView]:
    """Predict the test views of a dataset, one after the other.

    Parameters
    ----------
    dataset : an open dataset
    model : Gaussians or voxels
    unreliable : voxels whose rays are marked; None where there are none

    Yields
    ------
    measured and expected counts of each view
    """
    yield from _predicted(dataset, model, dataset.splits["test"], unreliable)


def _predicted(
    dataset: Dataset, model: GaussianModel | Voxels, views: Int[np.ndarray, " view"], unreliable: Unreliable | None
) -> Iterator[HeldOutView]:
    """Predict views, one after the other."""
    noise = CountNoise.of(dataset)
    for first in range(0, len(views), VIEWS_AT_ONCE):
        some = views[first : first + VIEWS_AT_ONCE]
        measured = read_measurements(dataset, some, len(model.basis_names), separable=False)
        yield from run_parallel(lambda view: view(), _predict(measured, model, unreliable, noise))


def _predict(
    measured: Measurements, model: GaussianModel | Voxels, unreliable: Unreliable | None, noise: CountNoise
) -> Iterator[Callable[[], HeldOutView]]:
    """Predict some views together; the edges of each are found when its function is called."""
    lengths = model.line_integrals(measured.geometry).numpy()
    lengths = measured.with_profile(np.moveaxis(lengths, 1, -1))
    expected = np.moveaxis(measured.transmission.expected(lengths), -1, 1)
    open_beam = measured.gains * measured.open_beam
    marked = None if unreliable is None else _rays_through(unreliable, measured)
    for view, (counts, exposure) in enumerate(zip(measured.counts, measured.exposure, strict=True)):
        scale = exposure[:, None, None]
        through = None if marked is None else marked[view]
        scattered = measured.scattered(view)
        primary = expected[view] * measured.gains * scale
        found = counts
        if measured.statistical_weights is not None:  # lower bounds that are met tell no more
            bounds = measured.statistical_weights[view]
            found = np.where(bounds < 0, np.maximum(primary, -bounds * counts), counts).astype(np.float32)
        yield partial(
            HeldOutView.of,
            found + scattered,
            primary + scattered,
            open_beam * scale,
            marked=through,
            spread=noise.spread(primary, scattered),
        )


def _rays_through(unreliable: Unreliable, measured: Measurements) -> Bool[np.ndarray, "view row column"]:
    """Rays with a path in marked voxels of more than half the edge of a voxel."""
    one = Voxels(unreliable.marked[None].astype(np.float32), unreliable.grid, ("marked",))
    return one.line_integrals(measured.geometry).numpy()[:, 0] > 0.5 * min(unreliable.grid.spacing)


def score_test_views(
    dataset: Dataset, model: GaussianModel | Voxels, unreliable: Unreliable | None = None
) -> dict[str, Any]:
    """Score the predictions of the test views.

    Parameters
    ----------
    dataset : an open dataset
    model : Gaussians or voxels
    unreliable : voxels whose rays are scored apart; None where there are none

    Returns
    -------
    scores by channel, see `recon.evaluation.metrics.score_projections`
    """
    return score_projections(held_out_views(dataset, model, unreliable), dataset.spectra.channels)


def score_fitted_views(
    dataset: Dataset, model: GaussianModel | Voxels, unreliable: Unreliable | None = None
) -> dict[str, Any]:
    """Score the predictions of some training views: a fit that does not even explain these has failed.

    Parameters
    ----------
    dataset, model, unreliable : as in `score_test_views`

    Returns
    -------
    scores by channel, of `FITTED_VIEWS` views, evenly spread, and at least one of each set of channels
    """
    train = dataset.splits["train"]
    views = train[evenly_spread_views(view_groups(dataset.exposure[train]), FITTED_VIEWS)]
    return score_projections(_predicted(dataset, model, views, unreliable), dataset.spectra.channels)


def score_truth(
    truth: Truth,
    model: GaussianModel | Voxels | Real[np.ndarray, "..."],
    left_out: Bool[np.ndarray, "z y x"] | None = None,
) -> dict[str, Any]:
    """Score a model, or an array of basis volumes, against the truth, on the grid and in the basis of the truth.

    A basis that the model lacks is scored as a volume of zeros.

    Parameters
    ----------
    truth : truth of the dataset
    model : Gaussians or voxels, or an array of the shape of ``truth.volumes`` [1/mm]
    left_out : voxels without which bases are scored as well, on the grid of the truth; None where there are none

    Returns
    -------
    ``basis``, ``materials`` and ``cross_talk``, see `recon.evaluation.metrics`

    Raises
    ------
    InputError
        When an array has another shape than the volumes of the truth, or values that are not finite.
    """
    if not isinstance(model, GaussianModel | Voxels):
        model = _as_model(truth, model)
    volumes = _in_basis_of(truth, model.volume(truth.grid), model.basis_names)
    materials = score_materials(
        volumes, truth.fractions, truth.coefficients, truth.material_names, truth.basis_names, FULL_FRACTION
    )
    basis = score_basis_volumes(volumes, truth.volumes, truth.basis_names)
    if left_out is not None:
        elsewhere = score_elsewhere(volumes, truth.volumes, truth.basis_names, left_out)
        basis = {name: scores | elsewhere[name] for name, scores in basis.items()}
    return {"basis": basis, **materials}


def _as_model(truth: Truth, volumes: Real[np.ndarray, "..."]) -> Voxels:
    """An array as basis volumes on the grid of the truth."""
    values = np.asarray(volumes)
    if values.shape != truth.volumes.shape:
        what = f"{truth.volumes.shape}: basis functions {', '.join(truth.basis_names)}, then z, y, x"
        raise InputError(f"an array to score must have the shape of the true volumes, {what}; got {values.shape}")
    if not np.isfinite(values).all():
        raise InputError(f"{np.sum(~np.isfinite(values))} of {values.size} values to score are not finite")
    return Voxels(values.astype(np.float32), truth.grid, truth.basis_names)


def psnr_of_bases(truth: Truth, model: GaussianModel | Voxels) -> dict[str, float]:
    """Compute the PSNR of each basis that the model and the truth have.

    Parameters
    ----------
    truth : truth of the dataset
    model : Gaussians or voxels

    Returns
    -------
    PSNR [dB] by ``psnr_<name>``
    """
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
    """Score the initial volumes of a fit.

    Parameters
    ----------
    method : name of the method that made them
    truth : truth of the dataset
    volumes : the initial volumes [1/mm]
    names : names of their bases
    grid : grid of `volumes`

    Returns
    -------
    scores by method and basis; empty if the grid is not that of the truth
    """
    if grid != truth.grid:
        return {}
    return {method: score_basis_volumes(_in_basis_of(truth, volumes, names), truth.volumes, truth.basis_names)}


def _in_basis_of(
    truth: Truth, volumes: Float[np.ndarray, "basis z y x"], names: tuple[str, ...]
) -> Float[np.ndarray, "true_basis z y x"]:
    """Volumes in the order of the basis functions of the truth, zeros for those that are missing."""
    out = np.zeros((len(truth.basis_names), *truth.grid.shape), np.float32)
    for name, volume in zip(names, volumes, strict=True):
        if name in truth.basis_names:
            out[truth.basis_names.index(name)] = volume
    return out
