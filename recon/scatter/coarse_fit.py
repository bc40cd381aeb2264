"""Reconstructions with large voxels, which suffice for scatter, and the factor of scatter that explains the counts.

With scatter s S, expected counts are P + s S, where volumes determine P. The likelihood of the best volumes for each s
has, by the envelope theorem, the derivative

    d/ds log L = sum over rays (Y / (P + s S) - 1) S

at these volumes. Its zero is the factor that the counts ask for. Rays beside edges are left out, as large voxels cannot
explain them.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.optimize import root_scalar

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

PASSES = 10  # passes over the views of each reconstruction, as `OneStep` takes about on its coarsest voxels
NODE_TOLERANCE = 1e-3  # no unit; largest error of log counts by few energy nodes, as in `recon.gaussians.recipe.Recipe`
LARGEST = 16.0  # largest factor that is searched for; chosen by hand, not measured
SEARCHES = 8  # steps of a search between two factors at most; chosen by hand, not measured
ENOUGH = 0.02  # change of the factor at which a search ends; far below its error, see docs/howto/scatter.md

Volumes = Float[np.ndarray, "basis z y x"]


@dataclass(frozen=True, eq=False)
class CoarseFit:
    """Reconstructs a dataset with large voxels.

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
    def of(cls, dataset: Dataset, asked: Asked, on_iteration: OnIteration) -> "CoarseFit":
        """Choose the basis functions.

        Parameters
        ----------
        dataset : open dataset
        asked : basis functions, see `recon.kedge.basis_names.with_named`; as many as there are channels for None
        on_iteration : called after every pass over the views

        Returns
        -------
        what reconstructs
        """
        named, count = with_named(dataset, asked)
        spectra = named.spectra
        return cls(named, count or min(len(spectra.basis.names), len(spectra.channels)), asked, on_iteration)

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

    def factor(self, signal: SmoothSignal, voxels: int) -> float:
        """Find the factor of a scattered signal that explains the counts best.

        Parameters
        ----------
        signal : scattered signal
        voxels : along the longest axis of the grid, at least

        Returns
        -------
        the factor, from 0 to `LARGEST`
        """
        known: dict[float, float] = {}

        def slope(factor: float) -> float:
            if factor not in known:
                known[factor] = self._slope(signal, factor, voxels)
            return known[factor]

        if slope(0.0) <= 0:
            return 0.0
        high = 1.0
        while slope(high) > 0 and high < LARGEST:
            high *= 2
        if slope(high) > 0:
            return high
        low = max(factor for factor, value in known.items() if value > 0)
        found = root_scalar(slope, method="brentq", bracket=(low, high), xtol=ENOUGH, maxiter=SEARCHES)
        return float(found.root)

    def _slope(self, signal: SmoothSignal, factor: float, voxels: int) -> float:
        """Derivative of the log likelihood in the factor, at the best volumes for it."""
        channels = len(self.dataset.spectra.channels)
        dataset = self.dataset.with_scatter(signal.scaled(np.full(channels, factor)))
        measured, grid = self._measured(dataset, voxels)
        model = Voxels(self._reconstructed(measured, grid), grid, measured.basis_names)
        lengths = model.line_integrals(measured.geometry).numpy()
        expected = np.moveaxis(
            measured.transmission.expected(measured.with_profile(np.moveaxis(lengths, 1, -1))), -1, 1
        )
        scattered = replace(measured, scatter=signal.scaled(1 / dataset.spectra.quantum))
        total = 0.0
        for view, image in enumerate(measured.counts):
            primary = expected[view] * measured.gains * measured.exposure[view, :, None, None]
            whole, part = primary + measured.scattered(view), scattered.scattered(view)
            rest = np.divide(image - primary, whole, out=np.zeros_like(primary), where=whole > 0)
            total += float((rest * part)[:, edge_mask(lengths[view])].sum())
        return total

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
        return OneStep(levels=((1, PASSES),), curve=curve).reconstruct_counts(measured, grid, self.on_iteration)
