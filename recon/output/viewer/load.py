"""Content of a viewer from a run folder, and the dataset from which the run was made where it can be found."""

from pathlib import Path

from phantomgen.dataset.truth import Truth, read_truth
from phantomgen.display.viewer.content import Triple
from recon.output.viewer.content import RunContent
from recon.runs.read_run import StoredRun, read_run
from spectra.errors import DatasetError, Error, InputError


def load_run(folder: Path, dataset: Path | None = None, at: Triple | None = None) -> RunContent:
    """Read the content that is shown of a run.

    Parameters
    ----------
    folder : run folder
    dataset : dataset whose truth is compared, on the grid of the truth; where it is None the dataset from which the run
        was made, if it is beside the run or in the current folder and its truth has the grid of the run
    at : positions of the slices (x, y, z) [mm]; the centre where it is None

    Returns
    -------
    content

    Raises
    ------
    DatasetError
        When the folder is not a run, or `dataset` holds no truth.
    InputError
        When truth and run have no basis in common.
    """
    run = read_run(folder)
    truth = _own_truth(run) if dataset is None else _truth_of(run, dataset)
    grid = run.grid if truth is None else truth.grid
    return RunContent.of(run.name, grid, run.basis_names, run.on(grid), truth, run.gaussians, at)


def _truth_of(run: StoredRun, dataset: Path) -> Truth:
    """Truth of a dataset that is named; refuses one without truth or with other bases."""
    truth = read_truth(dataset)
    if truth is None:
        raise DatasetError(f"{dataset} holds no truth to compare with")
    if not set(truth.basis_names) & set(run.basis_names):
        bases = ", ".join(truth.basis_names)
        raise InputError(f"{dataset} has the bases {bases}, and none of the run's: {', '.join(run.basis_names)}")
    return truth


def _own_truth(run: StoredRun) -> Truth | None:
    """Truth of the scan that was reconstructed; None where it is not found."""
    for folder in (run.folder.resolve().parent, Path()):
        path = folder / run.dataset
        if not (run.dataset and path.is_file()):
            continue
        try:
            truth = read_truth(path)
        except Error:  # this file was not asked for
            continue
        if truth is not None and truth.grid == run.grid and set(truth.basis_names) & set(run.basis_names):
            return truth
    return None
