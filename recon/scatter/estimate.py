"""Estimates of scatter: from volumes that are reconstructed in turns with it, or from the counts by a kernel."""

from dataclasses import dataclass, replace
from math import ceil

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.reader import Dataset
from phantomgen.effects.scatter import ScatterKernel
from phantomgen.effects.smooth_signal import SmoothSignal, line_places
from phantomgen.geometry.voxel_grid import Grid
from recon.data.coverage import coverage
from recon.data.measurements import matching_bin, read_measurements
from recon.kedge.basis_names import Asked, OnCurve, with_named
from recon.scatter.compton import compton_signal
from recon.voxel.iterative.multigrid import coarser
from recon.voxel.iterative.one_step import OneStep
from recon.voxel.method import OnIteration, no_callback
from spectra.errors import InputError

# voxels along the longest axis of the grid, at least; of the reconstructions, each followed by an estimate. On
# kedge-small, scatter is 12 % too large with 16 voxels, 5 % with 32 and 2 % with 64; a third reconstruction changes it
# by 0.3 %
TURNS = (24, 48)
PASSES = 10  # passes over the views of each reconstruction, as `OneStep` takes on its coarsest voxels
# subtractions of the kernel's scatter at most, and relative change of scatter at which they end; chosen by hand
KERNEL_TURNS, KERNEL_CHANGE = 50, 3e-4
LEAST_PRIMARY = 0.02  # part of the counts that a kernel leaves as primary signal; chosen by hand, not measured

Volumes = Float[np.ndarray, "basis z y x"]


@dataclass(frozen=True)
class Compton:
    """Single Compton scatter of the reconstructed object.

    Parameters
    ----------
    scale : factor of the computed scatter, such as what a grid lets through, or above 1 for multiple scatter

    Raises
    ------
    InputError
        When the factor is negative or not finite.
    """

    scale: float = 1.0

    def __post_init__(self) -> None:
        if not 0 <= self.scale < np.inf:
            raise InputError(f"a factor of scatter must be finite and not negative, got {self.scale:g}")


def estimate_scatter(
    dataset: Dataset,
    model: Compton | ScatterKernel,
    asked: Asked = None,
    on_iteration: OnIteration = no_callback,
) -> SmoothSignal:
    """Estimate the scatter in every view of a dataset.

    Parameters
    ----------
    dataset : open dataset
    model : how photons are scattered
    asked : basis functions of the reconstructions, see `recon.kedge.basis_names.with_named`
    on_iteration : called after every pass over the views

    Returns
    -------
    expected scattered signal

    Raises
    ------
    InputError
        When the model does not suit the dataset.
    """
    if isinstance(model, ScatterKernel):
        return _by_kernel(dataset, model)
    if dataset.geometry.is_parallel:
        raise InputError(f"{dataset.path} has parallel rays: Compton scatter needs a source point, take a kernel")
    named, count = with_named(dataset, asked)
    if count is None:
        count = min(len(named.spectra.basis.names), len(named.spectra.channels))
    signal = None
    for voxels in TURNS:
        current = named if signal is None else named.with_scatter(signal)
        volumes, grid = _coarse_volumes(current, count, asked, voxels, on_iteration)
        factors = np.full(len(named.spectra.channels), model.scale)
        signal = compton_signal(named, volumes, grid).scaled(factors)
    assert signal is not None
    return signal


def _coarse_volumes(
    dataset: Dataset, count: int, asked: Asked, voxels: int, on_iteration: OnIteration
) -> tuple[Volumes, Grid]:
    """Reconstruct large voxels from the training views."""
    on_curve = isinstance(asked, OnCurve)
    measured = read_measurements(dataset, dataset.splits["train"], count, separable=not on_curve)
    whole = coverage(measured, dataset.grid).grid
    grid = coarser(whole, max(1, max(whole.shape) // voxels))
    binned = measured.binned(matching_bin(measured.geometry, min(grid.spacing)))
    few, _ = binned.compressed(1e-3)
    curve = asked.curve(dataset) if isinstance(asked, OnCurve) else None
    method = OneStep(levels=((1, PASSES),), curve=curve)
    return method.reconstruct_counts(few, grid, on_iteration), grid


def _by_kernel(dataset: Dataset, kernel: ScatterKernel) -> SmoothSignal:
    """Scatter of a kernel whose primary signal is what it leaves of the counts (Ohnesorge et al. 1999)."""
    panel, quantum = dataset.geometry.panel, dataset.spectra.quantum[:, None, None]
    rows, columns = (
        _kernel_places(panel.rows, panel.row_pitch, kernel),
        _kernel_places(panel.columns, panel.column_pitch, kernel),
    )
    plain, strength, found = dataset if dataset.scatter is None else replace(dataset, scatter=None), 0.0, []
    for view in range(len(dataset.geometry)):
        one = read_measurements(plain, np.array([view]), separable=False)
        exposure = one.exposure[0][:, None, None]
        whole, beam = one.counts[0] * quantum.astype(np.float64), one.gains * one.open_beam * exposure * quantum
        scattered = np.zeros_like(whole)
        for _ in range(KERNEL_TURNS):
            primary = np.maximum(whole - scattered, LEAST_PRIMARY * whole)
            strength = kernel.strength(primary, beam, panel) if view == 0 else strength
            before, scattered = scattered, strength * kernel.spread(primary, beam, panel)
            if np.abs(scattered - before).max() <= KERNEL_CHANGE * scattered.max(initial=0.0):
                break
        gain = np.mean(one.gains, axis=(1, 2), where=one.gains > 0, keepdims=True) * exposure
        per_gain = np.divide(scattered, gain, out=np.zeros_like(scattered), where=gain > 0)
        found.append(per_gain[:, rows[:, None], columns])
    return SmoothSignal(np.stack(found))


def _kernel_places(count: int, pitch: float, kernel: ScatterKernel) -> np.ndarray:
    """Pixels next to evenly spread places that lie no further apart than half of a kernel's full width."""
    places = min(count, 4 + ceil(count * pitch / (kernel.width / 2)))
    return np.clip(np.rint(line_places(count, places)), 0, count - 1).astype(int)
