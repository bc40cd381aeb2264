"""Reconstructions with an insert and without it.

Both classes are drawn from the result of a run, or from the truth: counts that it expects, and counts that it expects
when the insert is replaced by the mean of its surroundings. Each class is reconstructed with noise of its own and with
the settings of the run, so that a method may respond to noise and to the insert in any way.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.truth import Truth
from phantomgen.geometry.voxel_grid import Grid
from recon.data.measurements import read_measurements
from recon.detectability.insert import Insert, WithoutInsert
from recon.gaussians.model import GaussianModel
from recon.quality.observers import ideal_square
from recon.runs.interfaces import Watcher
from recon.uncertainty.estimate import FOLDER, RepeatableRun, reconstruct_replicates
from recon.uncertainty.replicate import expected_quanta
from recon.uncertainty.spread import Replicates
from recon.voxel.model import Voxels
from spectra.errors import InputError

QUALITY = "quality"  # folder in that of a run
ABSENT = 1 << 31  # first number of replicates without the insert, so that their noise is another


@dataclass(frozen=True, eq=False)
class Classes:
    """Reconstructions of a run with and without an insert.

    Parameters
    ----------
    insert : the insert
    present, absent : reconstructions
    ideal : d' of the ideal observer of the counts
    """

    insert: Insert
    present: Replicates
    absent: Replicates
    ideal: float


def reconstruct_classes(
    run: RepeatableRun,
    insert: Insert,
    pairs: int,
    seed: int,
    watcher: Watcher,
    on_replicate: Callable[[int], None] = lambda number: None,
    truth: Truth | None = None,
) -> Classes:
    """Reconstruct both classes; those that are there already are kept.

    Parameters
    ----------
    run : run, scan and method
    insert : the insert
    pairs : number of reconstructions of each class
    seed : of their noise
    watcher : shows the progress of each
    on_replicate : called before each with its number, counted from 0 over both classes
    truth : what counts are drawn from, in place of the result of the run

    Returns
    -------
    the reconstructions, and d' of the ideal observer

    Raises
    ------
    InputError
        When the insert is not in the volume, too close to its edge, or as dense as its surroundings.
    """
    grid = run.grid
    insert.layers(grid)
    insert.window(grid)
    model, folder = run.stored.model, quality_folder(run.folder, insert)
    measured, with_insert, without_insert = run.dataset, run.folder / FOLDER, folder / "absent"
    if truth is not None:
        measured = run.whole
        model = true_volumes(truth, grid, measured.spectra.basis.names)
        with_insert, without_insert = folder / "true_present", folder / "true_absent"
    without = WithoutInsert(model, Voxels(insert.excess(model.volume(grid), grid), grid, model.basis_names))
    square = ideal_observer_square(measured, model, without)
    if not square > 0:
        raise InputError(f"the insert at {insert} mm changes no count: it is as dense as its surroundings")
    present = reconstruct_replicates(run, model, with_insert, range(pairs), seed, watcher, on_replicate, measured)
    absent = reconstruct_replicates(
        run,
        without,
        without_insert,
        range(ABSENT, ABSENT + pairs),
        seed,
        watcher,
        lambda k: on_replicate(pairs + k - ABSENT),
        measured,
    )
    return Classes(insert, present, absent, float(np.sqrt(square)))


def true_volumes(truth: Truth, grid: Grid, names: tuple[str, ...]) -> Voxels:
    """Return the true volumes as a model of the scan.

    Parameters
    ----------
    truth : of the scan
    grid : grid of the volumes
    names : basis functions of the dataset, of which the run may have fewer

    Returns
    -------
    volumes of these basis functions

    Raises
    ------
    InputError
        When the truth has another grid, or lacks a basis function.
    """
    missing = [name for name in names if name not in truth.basis_names]
    if missing or truth.grid != grid:
        raise InputError(
            f"the truth has the basis functions {', '.join(truth.basis_names)} on {truth.grid.shape} voxels, the scan "
            f"{', '.join(names)} on {grid.shape}: leave --truth out"
        )
    return Voxels(truth.volumes[[truth.basis_names.index(name) for name in names]], grid, names)


def quality_folder(run: Path, insert: Insert) -> Path:
    """Return the folder for the quality of an insert.

    Parameters
    ----------
    run : folder of the run
    insert : the insert

    Returns
    -------
    path of the folder
    """
    return run / QUALITY / str(insert)


def ideal_observer_square(dataset: Dataset, model: GaussianModel | Voxels, without: WithoutInsert) -> float:
    """Compute d'^2 of the ideal observer of all training views and channels.

    Parameters
    ----------
    dataset : the scan
    model, without : the result with and without the insert

    Returns
    -------
    sum over all counts of the squared difference over the variance
    """
    total = 0.0
    for view in dataset.splits["train"]:
        one = read_measurements(dataset, np.array([view]), len(model.basis_names), separable=False)
        with_insert, other = expected_quanta(one, model), expected_quanta(one, without)
        total += ideal_square(with_insert, other, (with_insert + other) / 2 + one.scattered(0))
    return total
