"""Scans that get worse and worse: the default fit against SIRT, both by the truth."""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from phantomgen.correction.run import correct_file
from phantomgen.dataset.reader import Dataset, open_dataset
from phantomgen.dataset.truth import read_truth
from phantomgen.degradation.degraded_scan import DegradedScan
from phantomgen.degradation.run import degrade_file
from phantomgen.degradation.settings import Degradation
from phantomgen.runtime.stopwatch import Stopwatch
from phantomgen.stress.case import Case, Point
from recon.gaussians.recipe import RECIPES
from recon.runs.interfaces import Unwatched
from recon.runs.run_gaussians import GaussianRun
from recon.runs.run_voxels import VoxelRun
from recon.voxel.iterative.sirt import Sirt
from spectra.errors import Error, InputError

_ERROR = "error of the fit over that of SIRT"
_LIMIT = 1.0


@dataclass(frozen=True)
class _Trap:
    """A way to make a scan worse.

    Parameters
    ----------
    name, what, difficulty : as in `Case`
    steps : from easy to hard
    settings : of one step
    corrected : whether the scan goes through the corrections of ``phantomgen correct`` before it is reconstructed
    """

    name: str
    what: str
    difficulty: str
    steps: Sequence[float]
    settings: Callable[[float], Degradation]
    corrected: bool = False


_TRAPS = (
    _Trap("views", "few views", "training views", (30, 20, 10, 5, 3), lambda n: Degradation(views=int(n))),
    _Trap("arc", "views of an arc", "arc [degree]", (270, 180, 120, 90, 60), lambda a: Degradation(arc=(0.0, a))),
    _Trap("dose", "low dose", "part of the dose", (0.3, 0.1, 0.01, 1e-3, 1e-4), lambda d: Degradation(dose=d)),
    _Trap("truncated", "a narrow panel", "part cut off", (0.1, 0.2, 0.3, 0.5), lambda part: Degradation(truncate=part)),
    _Trap("dead", "dead pixels", "part of the pixels", (0.001, 0.01, 0.05, 0.2), lambda part: Degradation(dead=part)),
    _Trap("columns", "dead columns", "columns", (1, 2, 4, 8), lambda n: Degradation(dead_columns=int(n))),
    _Trap("hot", "hot pixels", "part of the pixels", (0.001, 0.01, 0.05, 0.2), lambda n: Degradation(hot=n), True),
    _Trap(
        "saturated", "pixels that saturate", "largest reading", (1, 0.8, 0.5, 0.3), lambda x: Degradation(saturate=x)
    ),
    _Trap("drift", "a drifting tube", "part lost", (0.01, 0.05, 0.2, 0.5), lambda part: Degradation(drift=part), True),
    _Trap("shift", "panel stated wrongly", "distance [pixel]", (0.1, 0.25, 0.5, 1), lambda d: Degradation(shift=d)),
    _Trap("tilt", "panel stated turned", "angle [degree]", (0.1, 0.3, 1, 3), lambda angle: Degradation(tilt=angle)),
    _Trap("voltage", "voltage stated wrongly", "error [kV]", (0.5, 1, 3, 6), lambda kv: Degradation(kv_error=kv)),
)


def cases_of(path: Path) -> tuple[Case, ...]:
    """Return the cases of a scan.

    Parameters
    ----------
    path : dataset with its truth

    Returns
    -------
    cases; points of each are made and fitted when it runs. Steps that the scan does not allow are left out, such as
    more views than it has, and cases without any

    Raises
    ------
    InputError
        When it has no truth, or fewer channels than basis functions.
    """
    _check(path)
    with open_dataset(path) as dataset:
        traps = [replace(trap, steps=[s for s in trap.steps if _allowed(dataset, trap.settings(s))]) for trap in _TRAPS]
    return tuple(
        Case(trap.name, trap.what, trap.difficulty, _ERROR, _LIMIT, partial(_points, path, trap))
        for trap in traps
        if trap.steps
    )


def _allowed(dataset: Dataset, settings: Degradation) -> bool:
    """Whether a scan can be made worse in this way."""
    try:
        DegradedScan(dataset, settings, 1).check()
    except Error:
        return False
    return True


def _check(path: Path) -> None:
    """Refuse what is no dataset with a truth."""
    truth = read_truth(path)
    with open_dataset(path) as dataset:
        names, grid, channels = dataset.spectra.basis.names, dataset.grid, len(dataset.spectra.channels)
    if truth is None or truth.grid != grid or not set(names) <= set(truth.basis_names):
        raise InputError(
            f"{path} has no truth of all its basis functions on its voxels, which a fit could be compared with: "
            "name a scan that `phantomgen make` wrote"
        )
    if channels < len(names):
        raise InputError(
            f"{path} has {channels} channels for {len(names)} basis functions: name a scan with one for each"
        )


def _points(path: Path, trap: _Trap) -> Iterator[Point]:
    """Make the scan worse step by step, and reconstruct it by both methods."""
    with tempfile.TemporaryDirectory() as folder:
        for step in trap.steps:
            worse = Path(folder) / "worse.h5"
            degrade_file(path, worse, trap.settings(step), overwrite=True, compression="none")
            if trap.corrected:
                worse = correct_file(worse, Path(folder) / "corrected.h5", overwrite=True).path
            found, expected = (_error(worse, way) for way in (_gaussians, _sirt))
            yield Point(step, found, expected, found / expected)


def _error(path: Path, way: Callable[[tuple[str, ...]], GaussianRun | VoxelRun]) -> float:
    """Root mean square error of a reconstruction, in parts of the largest true value of each basis function."""
    truth = read_truth(path)
    assert truth is not None, "`_check` refuses scans without a truth"
    with open_dataset(path) as dataset:
        names = dataset.spectra.basis.names
        volumes = way(names).reconstruct(dataset, None, Stopwatch(), Unwatched()).volumes
    true = truth.volumes[[truth.basis_names.index(name) for name in names]]
    peaks = true.max(axis=(1, 2, 3), initial=0)
    used = peaks > 0
    return float(np.sqrt(np.mean(((volumes - true)[used] / peaks[used, None, None, None]) ** 2)))


def _gaussians(names: tuple[str, ...]) -> GaussianRun:
    return GaussianRun(RECIPES["fast"], bases=names)


def _sirt(names: tuple[str, ...]) -> VoxelRun:
    return VoxelRun(Sirt(), bases=names)
