"""Runs of methods that predict views and have no volume."""

from dataclasses import asdict, dataclass
from pathlib import Path

from phantomgen.dataset.reader import Dataset
from phantomgen.runtime.stopwatch import Stopwatch
from recon.data.measured_rays import ray_weights
from recon.data.measurements import read_measurements
from recon.kedge.basis_names import Asked, bases_text
from recon.runs.checks import PIPELINES, check_method
from recon.runs.interfaces import Watcher
from recon.runs.outcomes.iteration_log import IterationLog
from recon.runs.outcomes.view_outcome import ViewOutcome
from recon.voxel.image_domain import log_projections
from recon.voxel.method import Iteration, ViewMethod
from spectra.errors import InputError


@dataclass(frozen=True)
class ViewRun:
    """A method that predicts views, with all that steers it; a `recon.runs.interfaces.RunMethod`.

    Parameters
    ----------
    method : see `recon.runs.methods`
    pipeline : the first of `recon.runs.checks.PIPELINES`; others are refused
    bases : None; others are refused, as the method has none
    """

    method: ViewMethod
    pipeline: str = PIPELINES[0]
    bases: Asked = None

    def check(self, dataset: Dataset) -> None:
        """Refuse what `recon.runs.checks.check_method` refuses, and basis functions.

        Parameters
        ----------
        dataset : open dataset, of which counts are not read

        Raises
        ------
        InputError
            When bases are asked for.
        """
        check_method(self.method, self.pipeline, dataset)
        if self.bases is not None:
            raise InputError(
                f"the method {self.method.name} predicts views and has no basis volumes: "
                f"leave --bases {bases_text(self.bases)} out"
            )

    def reconstruct(self, dataset: Dataset, folder: Path | None, clock: Stopwatch, watcher: Watcher) -> ViewOutcome:
        """Learn from the training views to predict others.

        Parameters
        ----------
        dataset : open dataset; only ``/entry`` is read
        folder : run folder, for the log; None where another process writes it
        clock : times the stages
        watcher : shows the progress

        Returns
        -------
        the model of views
        """
        with clock("read"):
            measured = read_measurements(dataset, dataset.splits["train"]).completed()
            images = log_projections(measured)
        log = IterationLog(folder, dataset.grid, ())

        def on_iteration(iteration: Iteration) -> None:
            log.add(iteration)
            watcher.iterated(iteration)

        with clock(self.method.name):
            seen = ray_weights(measured.blind_pixels, len(measured))
            views = self.method.learn_views(images, seen, measured.geometry, dataset.grid, on_iteration)
        log.write()
        settings = {"method": self.method.name} | asdict(self.method)  # type: ignore[call-overload] - methods are dataclasses
        return ViewOutcome(dataset, views, settings)
