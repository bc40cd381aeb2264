"""Timed runs of methods that predict views and have no volume."""

from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np

from phantomgen.dataset.reader import Dataset
from phantomgen.geometry.poses import Geometry
from recon.comparison.contenders.clock import BudgetSpent
from recon.comparison.contenders.model import Model, Runs, StoredViews
from recon.comparison.contenders.recorder import Recorder
from recon.data.measured_rays import ray_weights
from recon.data.measurements import read_measurements
from recon.voxel.image_domain import log_projections
from recon.voxel.method import Iteration, ViewMethod, ViewModel


def run_views(dataset: Dataset, method: ViewMethod, recorder: Recorder) -> Runs:
    """Run until the largest budget is over, or the method is finished.

    Parameters
    ----------
    dataset : open dataset, restricted to what the contender may use; only ``/entry`` is read
    method : predicts views
    recorder : gets the prediction of the test views after every iteration

    Returns
    -------
    the run
    """
    test = dataset.geometry[dataset.splits["test"]]

    def record(iteration: Iteration) -> None:
        assert iteration.views is not None
        recorder.add(iteration.done, iteration.total, partial(_save, iteration.views, test))

    recorder.clock.start()
    measured = read_measurements(dataset, dataset.splits["train"]).completed()
    weights = ray_weights(measured.blind_pixels, len(measured))
    with suppress(BudgetSpent):
        method.learn_views(log_projections(measured), weights, measured.geometry, dataset.grid, record)
        recorder.finished = True
    recorder.clock.stop()
    return Runs((recorder,), _load)


def _save(views: ViewModel, geometry: Geometry, path: Path) -> None:
    with path.open("wb") as file:
        np.save(file, views(geometry).astype(np.float32))


def _load(path: Path) -> Model:
    with path.open("rb") as file:
        return Model(None, views=StoredViews(np.load(file)))
