"""Estimates of scatter: from volumes that are reconstructed in turns with it, or from the counts by a kernel."""

from dataclasses import dataclass, replace
from math import ceil

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.reader import Dataset
from phantomgen.effects.scatter import ScatterKernel
from phantomgen.effects.smooth_signal import SmoothSignal, spline_weights
from recon.data.measurements import read_measurements
from recon.kedge.basis_names import Asked
from recon.scatter.coarse_fit import CoarseFit
from recon.scatter.compton import compton_signal
from recon.voxel.method import OnIteration, no_callback
from spectra.errors import InputError

# voxels along the longest axis of the grid, at least; of the reconstructions, each followed by an estimate. On
# kedge-small, scatter is 12 % too large with 16 voxels, 5 % with 32 and 2 % with 64; a third reconstruction changes it
# by 0.3 %
TURNS = (24, 48)
# subtractions of the kernel's scatter at most, and relative change of scatter at which they end; chosen by hand
KERNEL_TURNS, KERNEL_CHANGE = 50, 3e-4
LEAST_PRIMARY = 0.02  # part of the counts that a kernel leaves as primary signal; chosen by hand, not measured


@dataclass(frozen=True)
class Compton:
    """Single Compton scatter of the reconstructed object.

    Parameters
    ----------
    factor : of the computed scatter, such as what a grid lets through, or above 1 for multiple scatter; None for the
        factor that explains the counts best

    Raises
    ------
    InputError
        When the factor is negative or not finite.
    """

    factor: float | None = 1.0

    def __post_init__(self) -> None:
        if self.factor is not None and not 0 <= self.factor < np.inf:
            raise InputError(f"a factor of scatter must be finite and not negative, got {self.factor:g}")


ScatterModel = Compton | ScatterKernel


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
    if isinstance(model, ScatterKernel):
        return ScatterEstimate(_by_kernel(dataset, model))
    coarse = CoarseFit.of(dataset, asked, on_iteration)
    if dataset.geometry.is_parallel:
        raise InputError(f"{dataset.path} has parallel rays: Compton scatter needs a source point, take a kernel")
    current, signal, factor = coarse.dataset, None, 1.0
    for voxels in TURNS:
        single = compton_signal(coarse.dataset, *coarse.volumes(current, voxels))
        factor = coarse.factor(single, voxels) if model.factor is None else model.factor
        signal = single.scaled(np.full(len(dataset.spectra.channels), factor))
        current = coarse.dataset.with_scatter(signal)
    assert signal is not None
    return ScatterEstimate(signal, f"factor of Compton scatter {factor:.3g}" if model.factor is None else "")


def _by_kernel(dataset: Dataset, kernel: ScatterKernel) -> SmoothSignal:
    """Scatter of a kernel whose primary signal is what it leaves of the counts (Ohnesorge et al. 1999)."""
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
            before, scattered = scattered, strength * kernel.spread(primary, beam, panel)
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
