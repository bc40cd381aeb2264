"""Reconstruct replicates of a run and write what they say: ``replicates/`` and ``uncertainty.h5`` in its folder."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.reader import Dataset
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.runtime.output_lock import acquire
from phantomgen.runtime.stopwatch import Stopwatch
from recon.calibration.refine import ChosenSpectrum
from recon.runs.interfaces import RunMethod, Watcher
from recon.runs.outcomes.volume_outcome import VolumeOutcome
from recon.runs.read_run import StoredModel, open_model, read_run
from recon.runs.write_run import write_volumes
from recon.scatter.chosen_scatter import ChosenScatter
from recon.uncertainty.replicate import ProjectedModel, Replicate
from recon.uncertainty.spread import Replicates, Spread
from recon.uncertainty.stored_method import stored_method
from spectra.errors import DatasetError, InputError

FOLDER, DEVIATIONS = "replicates", "uncertainty.h5"


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Standard deviations of the basis volumes of a run.

    Parameters
    ----------
    replicates : reconstructions of the same scan with other noise
    spread : mean and standard deviation of each basis in every voxel [1/mm]
    bias : mean of the replicates minus the volumes of the run, which they were drawn from [1/mm]; an estimate of the
        error that is the same whatever the noise
    """

    replicates: Replicates
    spread: Spread
    bias: Float[np.ndarray, "basis z y x"]


def estimate(
    folder: Path,
    dataset: Dataset,
    count: int,
    seed: int,
    watcher: Watcher,
    on_replicate: Callable[[int], None] = lambda number: None,
) -> Uncertainty:
    """Reconstruct replicates of a run with its own settings; those that are there already are kept.

    Parameters
    ----------
    folder : run folder
    dataset : the scan of the run, open
    count : number of replicates, at least 2
    seed : of their noise
    watcher : shows the progress of each
    on_replicate : called with the number of each replicate before it is made

    Returns
    -------
    the standard deviations, which are in the folder as well

    Raises
    ------
    DatasetError
        When the folder is no run, or the dataset is not that of the run.
    InputError
        When its method has no volumes.
    """
    if count < 2:
        raise InputError(f"a standard deviation needs two replicates at least, got {count}")
    run, place = RepeatableRun.of_run(folder, dataset), folder / FOLDER
    replicates = reconstruct_replicates(run, run.stored.model, place, range(count), seed, watcher, on_replicate)
    found = replicates.spread()
    uncertainty = Uncertainty(replicates, found, found.mean - read_run(folder).volumes)
    others = {"bias": uncertainty.bias}
    write_volumes(folder / DEVIATIONS, found.deviation, replicates.basis_names, replicates.grid, others)
    return uncertainty


@dataclass(frozen=True, eq=False)
class RepeatableRun:
    """A run with its scan and its method, so that counts with other noise are reconstructed in the same way.

    Parameters
    ----------
    folder : of the run
    stored : its result
    dataset : the scan, with the basis functions, the spectral model and the scatter of the run
    whole : the same with all basis functions that the file states, of which the run may have fewer
    method : with the settings of the run
    """

    folder: Path
    stored: StoredModel
    dataset: Dataset
    whole: Dataset
    method: RunMethod

    @classmethod
    def of_run(cls, folder: Path, dataset: Dataset) -> "RepeatableRun":
        """Read a run.

        Parameters
        ----------
        folder : of the run
        dataset : its scan, open

        Returns
        -------
        run, scan and method

        Raises
        ------
        DatasetError
            When the folder is no run, or the dataset is not that of the run.
        InputError
            When its method has no volumes.
        """
        stored = open_model(folder)
        whole = _scan_of(stored, dataset, folder)
        scan = whole.with_basis(stored.basis)
        method = stored_method(folder, len(stored.model.basis_names))
        method.check(scan)
        return cls(folder, stored, scan, whole, method)

    @property
    def grid(self) -> Grid:
        """Grid of the volumes."""
        return self.dataset.grid


def reconstruct_replicates(
    run: RepeatableRun,
    model: ProjectedModel,
    place: Path,
    numbers: range,
    seed: int,
    watcher: Watcher,
    on_replicate: Callable[[int], None] = lambda number: None,
    measured: Dataset | None = None,
) -> Replicates:
    """Reconstruct scans whose counts are drawn anew around those that a model expects; keep those that are there.

    Parameters
    ----------
    run : run, scan and method
    model : what the counts are drawn around
    place : folder of the reconstructions, made where there is none
    numbers : of the replicates; the same number has the same noise
    seed : of the noise
    watcher : shows the progress of each
    on_replicate : called with the number of each before it is made
    measured : the scan in the basis functions of `model`, where these are not those of the run

    Returns
    -------
    the reconstructions
    """
    place.mkdir(exist_ok=True, parents=True)
    lock = acquire(place)
    try:
        paths = {number: place / f"seed_{seed}_{number:03d}.h5" for number in numbers}
        for number, path in paths.items():
            if path.is_file():
                continue
            on_replicate(number)
            replicate = Replicate.of(run.dataset, model, seed, number, measured)
            outcome = run.method.reconstruct(replicate, None, Stopwatch(watcher.stage), watcher)
            assert isinstance(outcome, VolumeOutcome)
            write_volumes(path, outcome.model.volume(run.grid), run.stored.model.basis_names, run.grid, {})
        return Replicates.read(list(paths.values()))
    finally:
        lock.unlink(missing_ok=True)


def stored_replicates(folder: Path) -> Replicates:
    """Find the replicates of a run.

    Parameters
    ----------
    folder : run folder

    Returns
    -------
    all replicates of the seed that has most

    Raises
    ------
    DatasetError
        When there are none.
    """
    groups: dict[str, list[Path]] = {}
    for path in sorted((folder / FOLDER).glob("seed_*_*.h5")):
        groups.setdefault(path.stem.rsplit("_", 1)[0], []).append(path)
    if not groups:
        raise DatasetError(f"{folder} has no replicates: make them by `recon uncertainty {folder}`")
    return Replicates.read(max(groups.values(), key=len))


def _scan_of(stored: StoredModel, dataset: Dataset, folder: Path) -> Dataset:
    """Dataset with the spectral model and the scatter of a run; refuses another scan."""
    if stored.grid != dataset.grid or stored.transmission.channel_names != dataset.spectra.channels:
        raise DatasetError(f"{dataset.path} has another grid or other channels than the scan of {folder}")
    return ChosenScatter.of_run(ChosenSpectrum.of_run(dataset, folder).dataset, folder).dataset
