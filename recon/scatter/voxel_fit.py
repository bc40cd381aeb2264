"""Reconstructions that estimates of scatter need, and how the likelihood changes with scatter.

With scatter s S in every channel, expected counts are P + s S, where volumes determine P. The likelihood of the best
volumes for each s has, by the envelope theorem, the derivative

    d/ds log L = sum over rays (Y / (P + s S) - 1) S

at these volumes. Its zero is the factor that the counts ask for. Rays beside edges are left out, as voxels cannot
explain them.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from phantomgen.dataset.reader import Dataset
from phantomgen.effects.smooth_signal import SmoothSignal
from phantomgen.geometry.voxel_grid import Grid
from recon.data.coverage import coverage
from recon.data.measurements import Measurements, matching_bin, read_measurements
from recon.data.projection_edges import edge_mask
from recon.kedge.basis_names import Asked, OnCurve, with_named
from recon.voxel.iterative.multigrid import coarser
from recon.voxel.iterative.one_step import OneStep
from recon.voxel.method import OnIteration, no_callback
from recon.voxel.model import Voxels

PASSES = 10  # passes over the views with large voxels, as `OneStep` takes about on its coarsest voxels
MANY = 64  # voxels along the longest axis; reconstructions of as many or more begin with larger voxels
NODE_TOLERANCE = 1e-3  # no unit; largest error of log counts by few energy nodes, as in `recon.gaussians.recipe.Recipe`

Volumes = Float[np.ndarray, "basis z y x"]


@dataclass(frozen=True, eq=False)
class VoxelFit:
    """Reconstructs a dataset with voxels of any size.

    Parameters
    ----------
    dataset : in the basis functions that are reconstructed
    count : number of them
    asked : basis functions as a user asks for them; a curve of materials is followed
    on_iteration : called after every pass over the views
    """

    dataset: Dataset
    count: int
    asked: Asked = None
    on_iteration: OnIteration = no_callback

    @classmethod
    def of(cls, dataset: Dataset, asked: Asked, on_iteration: OnIteration) -> "VoxelFit":
        """Choose the basis functions.

        Parameters
        ----------
        dataset : open dataset
        asked : basis functions, see `recon.kedge.basis_names.with_named`; as many as there are channels for None,
            and all of a curve
        on_iteration : called after every pass over the views

        Returns
        -------
        what reconstructs
        """
        named, count = with_named(dataset, asked)
        spectra = named.spectra
        named_count = len(spectra.basis.names)
        free = named_count if isinstance(asked, OnCurve) else min(named_count, len(spectra.channels))
        return cls(named, count or free, asked, on_iteration)

    def volumes(self, dataset: Dataset, voxels: int) -> tuple[Volumes, Grid]:
        """Reconstruct the training views.

        Parameters
        ----------
        dataset : with an estimate of scatter, or without
        voxels : along the longest axis of the grid, at least

        Returns
        -------
        coefficients [1/mm], and their voxels
        """
        measured, grid = self._measured(dataset, voxels)
        return self._reconstructed(measured, grid), grid

    def slopes(
        self, signal: SmoothSignal, factors: Float[np.ndarray, " channel"], voxels: int
    ) -> Float[np.ndarray, " channel"]:
        """Compute the derivatives of the log likelihood in the factors of scatter, at the best volumes for them.

        Parameters
        ----------
        signal : scattered signal
        factors : of the signal in each channel
        voxels : along the longest axis of the grid, at least

        Returns
        -------
        one derivative per channel
        """
        dataset = self.dataset.with_scatter(signal.scaled(factors))
        measured, grid = self._measured(dataset, voxels)
        scattered = replace(measured, scatter=signal.scaled(1 / dataset.spectra.quantum))
        total = np.zeros(len(factors))
        for view, (image, primary, kept) in enumerate(_views(measured, self._reconstructed(measured, grid), grid)):
            whole, part = primary + measured.scattered(view), scattered.scattered(view)
            rest = np.divide(image - primary, whole, out=np.zeros_like(primary), where=whole > 0)
            total += (rest * part)[:, kept].sum(axis=1)
        return total

    def deviance_per_ray(self, volumes: Volumes, grid: Grid) -> float:
        """Compute how well volumes explain the training views, rays beside edges left out.

        Parameters
        ----------
        volumes : coefficients [1/mm]
        grid : their voxels

        Returns
        -------
        mean of the squared residuals over the variance of the counts; 1 where only noise is left
        """
        measured, _ = self._measured(self.dataset, max(grid.shape))
        total, count = 0.0, 0
        for view, (image, primary, kept) in enumerate(_views(measured, volumes, grid)):
            variance = (primary + measured.scattered(view))[:, kept]
            seen = variance > 0
            total += float((((image - primary)[:, kept][seen]) ** 2 / variance[seen]).sum())
            count += int(seen.sum())
        return total / max(count, 1)

    def _measured(self, dataset: Dataset, voxels: int) -> tuple[Measurements, Grid]:
        """Training views with pixels as large as the voxels, and these."""
        on_curve = isinstance(self.asked, OnCurve)
        measured = read_measurements(dataset, dataset.splits["train"], self.count, separable=not on_curve)
        whole = coverage(measured, dataset.grid).grid
        grid = coarser(whole, max(1, max(whole.shape) // voxels))
        return measured.binned(matching_bin(measured.geometry, min(grid.spacing))).compressed(NODE_TOLERANCE)[0], grid

    def _reconstructed(self, measured: Measurements, grid: Grid) -> Volumes:
        """Reconstruct by one-step voxels, on the curve of materials where one is asked for."""
        curve = self.asked.curve(self.dataset) if isinstance(self.asked, OnCurve) else None
        levels = ((1, PASSES),) if max(grid.shape) < MANY else OneStep().levels
        return OneStep(levels=levels, curve=curve).reconstruct_counts(measured, grid, self.on_iteration)


def _views(
    measured: Measurements, volumes: Volumes, grid: Grid
) -> Iterator[
    tuple[
        Float[np.ndarray, "channel row column"], Float[np.ndarray, "channel row column"], Bool[np.ndarray, "row column"]
    ]
]:
    """Counts without scatter of each view, what volumes expect, and the rays that pass no edge."""
    model = Voxels(volumes, grid, measured.basis_names)
    for view, image in enumerate(measured.counts):
        lengths = model.line_integrals(measured.geometry[[view]]).numpy()[0]
        expected = measured.transmission.expected(measured.with_profile(np.moveaxis(lengths, 0, -1)))
        primary = np.moveaxis(expected, -1, 0) * measured.gains * measured.exposure[view, :, None, None]
        yield image, primary, edge_mask(lengths)
