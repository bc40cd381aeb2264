"""Timed runs of voxel and view methods: one run, whose iterations give the results for all budgets."""

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from phantomgen.dataset.reader import Dataset
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.runtime.stopwatch import Stopwatch
from recon.comparison.contenders.channel_voxels import ChannelVoxels
from recon.comparison.contenders.clock import BudgetSpent
from recon.comparison.contenders.contender import Contender
from recon.comparison.contenders.model import Model, Runs
from recon.comparison.contenders.recorder import Recorder
from recon.comparison.contenders.timed_views import run_views
from recon.data.measurements import read_measurements
from recon.gaussians.recipe import Recipe
from recon.kedge.basis_names import OnCurve, with_named
from recon.runs.checks import check_curve, check_method
from recon.runs.methods import method_named
from recon.runs.run_voxels import reconstruct_volumes
from recon.voxel.image_domain import linear_response
from recon.voxel.iterative.multigrid import resampled
from recon.voxel.method import (  # fmt: skip
    Images,
    Iteration,
    LinearMethod,
    OnIteration,
    ViewMethod,
    Volumes,
    Weights,
    no_callback,
)
from recon.voxel.model import Voxels


def run_voxels(dataset: Dataset, contender: Contender, recorder: Recorder) -> Runs:
    """Run until the largest budget is over, or the method is finished.

    Parameters
    ----------
    dataset : open dataset, restricted to what the contender may use; only ``/entry`` is read
    contender : its method is one of `recon.runs.methods.METHODS`
    recorder : gets the volumes of every iteration

    Returns
    -------
    the run
    """
    method = method_named(contender.method)
    pipeline = "image" if contender.image else "two-step"
    check_method(method, pipeline, dataset)
    if isinstance(method, ViewMethod):
        return run_views(dataset, method, recorder)
    check_curve(method, contender.on_curve, dataset)
    if contender.on_curve:
        dataset, _ = with_named(dataset, OnCurve())
        method = replace(method, curve=OnCurve().curve(dataset))  # type: ignore[type-var] - methods are dataclasses
    grid, on_iteration = dataset.grid, no_callback

    def record(iteration: Iteration) -> None:
        save = partial(_save, iteration.volumes, iteration.grid or grid, grid)
        recorder.add(iteration.done, iteration.total, save)

    if contender.image and isinstance(method, LinearMethod):
        method = RecordedMethod(method, record)
    else:
        on_iteration = record
    recorder.clock.start()
    measured = read_measurements(dataset, dataset.splits["train"], contender.bases, separable=not contender.on_curve)
    measured = measured.without_partial_volume()
    measured = measured.compressed(Recipe().node_tolerance)[0]
    with suppress(BudgetSpent):
        reconstruct_volumes(measured, grid, method, pipeline, Stopwatch(), on_iteration)
        recorder.finished = True
    recorder.clock.stop()
    names = measured.basis_names
    if contender.image:
        return Runs((recorder,), partial(_channels, grid=grid, names=names, response=linear_response(measured)))
    return Runs((recorder,), partial(_bases, grid=grid, names=names))


@dataclass(frozen=True, eq=False)
class RecordedMethod:
    """A linear method whose volumes of the channels are recorded before they are decomposed.

    Parameters
    ----------
    method : reconstructs the channels
    record : called after every iteration, with the volumes of the channels
    """

    method: LinearMethod
    record: OnIteration

    @property
    def name(self) -> str:
        """Name of the method."""
        return self.method.name

    def reconstruct(
        self,
        line_integrals: Images,
        weights: Weights | None,
        geometry: Geometry,
        grid: Grid,
        on_iteration: OnIteration = no_callback,
    ) -> Volumes:
        """Reconstruct volumes, and record those of every iteration.

        Parameters
        ----------
        line_integrals : one image per channel and view [no unit]
        weights : statistical weight of each ray; None for equal weights
        geometry : poses of the views
        grid : of the volumes
        on_iteration : not used, as `record` is called in its place

        Returns
        -------
        volumes of the channels [1/mm]
        """
        del on_iteration
        return self.method.reconstruct(line_integrals, weights, geometry, grid, self.record)


def _save(volumes: Volumes, here: Grid, grid: Grid, path: Path) -> None:
    with path.open("wb") as file:
        np.save(file, resampled(volumes, here, grid).astype(np.float32))


def _load(path: Path) -> Volumes:
    with path.open("rb") as file:
        return np.load(file)


def _bases(path: Path, grid: Grid, names: tuple[str, ...]) -> Model:
    return Model(Voxels(_load(path), grid, names))


def _channels(path: Path, grid: Grid, names: tuple[str, ...], response: np.ndarray) -> Model:
    """Volumes of the channels, and the bases that fit them by least squares in every voxel."""
    channels = _load(path)
    bases = np.einsum("mc,czyx->mzyx", np.linalg.pinv(response).astype(np.float32), channels)
    return Model(Voxels(bases, grid, names), ChannelVoxels(channels, grid))
