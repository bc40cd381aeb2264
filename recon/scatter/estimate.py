"""Estimates of scatter: from volumes that are reconstructed in turns with it, or from the counts by a kernel."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.reader import Dataset
from phantomgen.effects.scatter import ScatterKernel
from phantomgen.effects.smooth_signal import SmoothSignal, spline_weights
from recon.data.measurements import read_measurements
from recon.kedge.basis_names import Asked
from recon.scatter.compton import compton_signal
from recon.scatter.factors import factor_between, factors_near
from recon.scatter.models import FIRST_RATIO, Compton, FittedKernel, ScatterModel
from recon.scatter.voxel_fit import VoxelFit
from recon.voxel.method import OnIteration, no_callback
from spectra.errors import InputError

# voxels along the longest axis of the grid, at least; of the reconstructions, each followed by an estimate. On
# kedge-small, scatter is 12 % too large with 16 voxels, 5 % with 32 and 2 % with 64; a third reconstruction changes it
# by 0.3 %
TURNS = (24, 48)
FINE = 128  # voxels along the longest axis, at least where the grid has them; of reconstructions that refine factors
# subtractions of the kernel's scatter at most, and relative change of scatter at which they end; chosen by hand
KERNEL_TURNS, KERNEL_CHANGE = 50, 3e-4
LEAST_PRIMARY = 0.02  # part of the counts that a kernel leaves as primary signal; chosen by hand, not measured


@dataclass(frozen=True, eq=False)
class ScatterEstimate:
    """Scatter of a dataset.

    Parameters
    ----------
    signal : expected scattered signal of every view
    fitted : what was fitted, in words; empty where nothing was
    """

    signal: SmoothSignal
    fitted: str = ""


def estimate_scatter(
    dataset: Dataset,
    model: ScatterModel,
    asked: Asked = None,
    on_iteration: OnIteration = no_callback,
) -> ScatterEstimate:
    """Estimate the scatter in every view of a dataset.

    Parameters
    ----------
    dataset : open dataset
    model : how photons are scattered
    asked : basis functions of the reconstructions, see `recon.kedge.basis_names.with_named`
    on_iteration : called after every pass over the views

    Returns
    -------
    the estimate

    Raises
    ------
    InputError
        When the model does not suit the dataset.
    """
    channels = dataset.spectra.channels
    if isinstance(model, ScatterKernel):
        return ScatterEstimate(_by_kernel(dataset, model, np.ones(len(channels))))
    fit = VoxelFit.of(dataset, asked, on_iteration)
    if isinstance(model, FittedKernel):
        return _fitted_kernel(fit, model)
    if dataset.geometry.is_parallel:
        raise InputError(f"{dataset.path} has parallel rays: Compton scatter needs a source point, take a kernel")
    factors = _given_factors(model, channels)
    current, single = fit.dataset, None
    for voxels in TURNS:
        single = compton_signal(fit.dataset, *fit.volumes(current, voxels))
        if model.factors is None:
            factors = _one_factor(fit, single, voxels)
        current = fit.dataset.with_scatter(single.scaled(factors))
    assert single is not None
    if model.factors is not None:
        return ScatterEstimate(single.scaled(factors))
    factors = _refined(fit, single, factors, model.each_channel)
    return ScatterEstimate(
        single.scaled(factors), f"factor of Compton scatter {_listed(factors, channels, model.each_channel)}"
    )


def _given_factors(model: Compton, channels: Sequence[str]) -> Float[np.ndarray, " channel"]:
    """Factors of all channels that a model states; 1 where they are fitted."""
    given = model.factors or (1.0,)
    if len(given) not in (1, len(channels)):
        raise InputError(
            f"{len(given)} factors of scatter do not suit the {len(channels)} channels {', '.join(channels)}: give one "
            "for all, or one for each"
        )
    return np.broadcast_to(np.array(given), (len(channels),))


def _one_factor(fit: VoxelFit, signal: SmoothSignal, voxels: int) -> Float[np.ndarray, " channel"]:
    """The same factor in all channels, found with large voxels."""
    ones = np.ones(signal.values.shape[1])
    return ones * factor_between(lambda factor: float(fit.slopes(signal, factor * ones, voxels).sum()))


def _refined(
    fit: VoxelFit, signal: SmoothSignal, factors: Float[np.ndarray, " channel"], each_channel: bool
) -> Float[np.ndarray, " channel"]:
    """One factor for all channels, or one for each, refined with voxels as small as those of the grid."""
    shared = np.eye(len(factors)) if each_channel else np.ones((len(factors), 1))

    def slopes(few: Float[np.ndarray, " factor"]) -> Float[np.ndarray, " factor"]:
        return shared.T @ fit.slopes(signal, shared @ few, FINE)

    return shared @ factors_near(slopes, factors[: shared.shape[1]])


def _listed(factors: Float[np.ndarray, " channel"], channels: Sequence[str], each_channel: bool) -> str:
    """Factors in words."""
    if not each_channel:
        return f"{factors[0]:.3g}"
    return ", ".join(f"{factor:.3g} ({name})" for factor, name in zip(factors, channels, strict=True))


def _fitted_kernel(fit: VoxelFit, model: FittedKernel) -> ScatterEstimate:
    """Scatter of a kernel whose ratio explains the counts best; the primary signal changes with the ratio."""
    channels = fit.dataset.spectra.channels
    kernel, ones = ScatterKernel(FIRST_RATIO, model.width), np.ones(len(channels))
    factors = _one_factor(fit, _by_kernel(fit.dataset, kernel, ones), TURNS[-1])
    factors = factors * _refined(fit, _by_kernel(fit.dataset, kernel, factors), ones, model.each_channel)
    signal = _by_kernel(fit.dataset, kernel, factors)
    return ScatterEstimate(
        signal, f"scatter over primary signal {_listed(FIRST_RATIO * factors, channels, model.each_channel)}"
    )


def _by_kernel(dataset: Dataset, kernel: ScatterKernel, factors: Float[np.ndarray, " channel"]) -> SmoothSignal:
    """Scatter of a kernel, whose primary signal is what it leaves of the counts (Ohnesorge et al. 1999)."""
    panel, quantum = dataset.geometry.panel, dataset.spectra.quantum[:, None, None]
    down = _spline_fit(panel.rows, panel.row_pitch, kernel)
    across = _spline_fit(panel.columns, panel.column_pitch, kernel)
    plain, strength, found = dataset if dataset.scatter is None else replace(dataset, scatter=None), 0.0, []
    for view in range(len(dataset.geometry)):
        one = read_measurements(plain, np.array([view]), separable=False)
        exposure = one.exposure[0][:, None, None]
        whole, beam = one.counts[0] * quantum.astype(np.float64), one.gains * one.open_beam * exposure * quantum
        scattered = np.zeros_like(whole)
        for _ in range(KERNEL_TURNS):
            primary = np.maximum(whole - scattered, LEAST_PRIMARY * whole)
            strength = kernel.strength(primary, beam, panel) if view == 0 else strength
            before, scattered = scattered, factors[:, None, None] * strength * kernel.spread(primary, beam, panel)
            if np.abs(scattered - before).max() <= KERNEL_CHANGE * scattered.max(initial=0.0):
                break
        gain = np.mean(one.gains, axis=(1, 2), where=one.gains > 0, keepdims=True) * exposure
        per_gain = np.divide(scattered, gain, out=np.zeros_like(scattered), where=gain > 0)
        found.append(np.einsum("ir,crk,jk->cij", down, per_gain, across, optimize=True))
    return SmoothSignal(np.stack(found))


def _spline_fit(count: int, pitch: float, kernel: ScatterKernel) -> Float[np.ndarray, "place pixel"]:
    """Weights from pixels to places that lie no further apart than half of a kernel's full width, by least squares."""
    places = min(count, 4 + ceil(count * pitch / (kernel.width / 2)))
    return np.linalg.pinv(spline_weights(count, places))
