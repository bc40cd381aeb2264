"""Runs of voxel methods.

There are three ways from counts to volumes of the bases. `two-step`: every ray is decomposed by maximum likelihood, and
the line integrals of each basis are reconstructed. `image`: each channel is reconstructed, and decomposed in every
voxel. A `recon.voxel.method.CountsMethod` reconstructs all bases from counts.
"""

from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.inpainting import inpainted
from phantomgen.dataset.reader import Dataset
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.runtime.stopwatch import Stopwatch
from recon.data.coverage import coverage, inner_box
from recon.data.incomplete_counts import saturation_notes
from recon.data.material_decomposition import decompose_views
from recon.data.measured_rays import ray_weights
from recon.data.measurements import Measurements, matching_bin, read_measurements
from recon.gaussians.recipe import Recipe
from recon.kedge.basis_names import Asked, OnCurve, left_out, with_named
from recon.runs.checks import PIPELINES, check_curve, check_method
from recon.runs.interfaces import Watcher
from recon.runs.outcomes.iteration_log import IterationLog
from recon.runs.outcomes.volume_outcome import VolumeOutcome
from recon.voxel.image_domain import reconstruct_channels
from recon.voxel.margin import with_margin_found
from recon.voxel.method import CountsMethod, Iteration, Method, OnIteration
from recon.voxel.model import Voxels
from recon.voxel.unreliable import unreliable_voxels


@dataclass(frozen=True)
class VoxelRun:
    """A voxel method with all that steers it; a `recon.runs.interfaces.RunMethod`.

    Parameters
    ----------
    method : see `recon.runs.methods`
    pipeline : one of `recon.runs.checks.PIPELINES`
    bases : how many of the dataset's basis functions to reconstruct, or their names; None for all
    """

    method: Method
    pipeline: str = PIPELINES[0]
    bases: Asked = None

    def check(self, dataset: Dataset) -> None:
        """Refuse what `recon.runs.checks.check_method` refuses.

        Parameters
        ----------
        dataset : open dataset, of which counts are not read
        """
        check_method(self.method, self.pipeline, dataset)
        check_curve(self.method, self._on_curve, dataset)

    def reconstruct(self, dataset: Dataset, folder: Path | None, clock: Stopwatch, watcher: Watcher) -> VolumeOutcome:
        """Reconstruct volumes from the training views.

        Parameters
        ----------
        dataset : open dataset; only ``/entry`` is read
        folder : run folder, for the log; None where another process writes it
        clock : times the stages
        watcher : shows the progress

        Returns
        -------
        volumes, without the margin of a truncated scan
        """
        stated = dataset.spectra.basis.names
        dataset, count = with_named(dataset, self.bases)
        method, on_curve = self.method, self._on_curve
        if isinstance(self.bases, OnCurve):
            method = replace(method, curve=self.bases.curve(dataset))  # type: ignore[type-var] - methods are dataclasses
        log = IterationLog(folder, dataset.grid, dataset.spectra.basis.names[:count])
        with clock("read"):
            measured = read_measurements(dataset, dataset.splits["train"], count, separable=not on_curve)
            covered = coverage(measured, dataset.grid)
            measured, node_error = measured.without_partial_volume().compressed(Recipe().node_tolerance)
            covered = with_margin_found(measured, covered) if isinstance(method, CountsMethod) else covered
        grid = covered.grid if isinstance(method, CountsMethod) else dataset.grid

        def on_iteration(iteration: Iteration) -> None:
            log.add(iteration)
            watcher.iterated(iteration)

        with_margin = reconstruct_volumes(measured, grid, method, self.pipeline, clock, on_iteration)
        volumes = np.ascontiguousarray(with_margin[:, *inner_box(dataset.grid, grid)])
        unreliable = None
        with clock("mark"):
            if not on_curve:  # on a curve, one number per voxel determines all bases
                unreliable = unreliable_voxels(volumes, measured, dataset.grid, Recipe().dispersion)
        log.write()
        notes = saturation_notes(dataset.spectra.channels, measured.bounded) if isinstance(method, CountsMethod) else ()
        way = {} if isinstance(method, CountsMethod) else {"pipeline": self.pipeline}
        settings = {"method": method.name} | way | asdict(method)  # type: ignore[call-overload] - methods are dataclasses
        names = measured.basis_names
        return VolumeOutcome(
            dataset, Voxels(volumes, dataset.grid, names), measured.transmission,
            {"dataset": dataset.path.name, "method": settings}, settings, node_error, Voxels(with_margin, grid, names),
            covered, unreliable, left_out(stated, names), notes=notes, log=log,
        )  # fmt: skip

    @property
    def _on_curve(self) -> bool:
        """Whether coefficients lie on a curve of materials: one that is asked for, or that of a stored run."""
        return isinstance(self.bases, OnCurve) or getattr(self.method, "curve", None) is not None


def reconstruct_volumes(
    measured: Measurements,
    grid: Grid,
    method: Method,
    pipeline: str,
    stage: Stopwatch,
    on_iteration: OnIteration,
) -> Float[np.ndarray, "basis z y x"]:
    """Reconstruct volumes of the bases from counts.

    Parameters
    ----------
    measured : training views
    grid : of the volumes
    method : voxel method
    pipeline : one of `recon.runs.checks.PIPELINES`; without effect for a method that takes counts
    stage : times the stages
    on_iteration : called after every iteration

    Returns
    -------
    volumes [1/mm]
    """
    if isinstance(method, CountsMethod):
        with stage(method.name):
            return method.reconstruct_counts(measured, grid, on_iteration)
    coarse = measured.completed().binned(matching_bin(measured.geometry, min(grid.spacing)))
    seen = ray_weights(coarse.blind_pixels, len(coarse))
    if pipeline == "image":
        with stage(method.name):
            return reconstruct_channels(coarse, seen, method, grid, on_iteration)
    with stage("decompose"):
        lengths = inpainted(decompose_views(coarse, Recipe().dispersion)[0], coarse.blind_pixels)
    with stage(method.name):
        images = np.ascontiguousarray(np.moveaxis(lengths, 1, 0))
        return method.reconstruct(images, seen, coarse.geometry, grid, on_iteration)
