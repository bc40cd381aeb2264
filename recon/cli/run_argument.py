"""The argument RUN of commands: a run folder, its scan, and messages for paths that are none."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from phantomgen.cli.common import debug_option, grouped, json_option, progress_options
from phantomgen.runtime.hdf5_signature import is_hdf5
from spectra.errors import DatasetError

_OF_A_RUN = ("volumes.h5", "model.safetensors", "metrics.json", "scan.json", "report.html", "log.jsonl")


class RunFolder(click.ParamType):
    """Type of an argument that is a run folder; the message for a file names the command that takes it."""

    name = "path"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Check that the value of the argument is a folder.

        Parameters
        ----------
        value : of the argument
        param, ctx : of click, not used

        Returns
        -------
        the folder

        Raises
        ------
        DatasetError
            When it is none.
        """
        del param, ctx
        path = Path(value)
        if path.is_dir():
            return path
        if not path.exists():
            raise DatasetError(f"there is no run folder {path}; make one by recon fit")
        if path.name in _OF_A_RUN:
            raise DatasetError(f"{path} is a file in a run folder: name the folder, {path.parent}")
        if is_hdf5(path):
            raise DatasetError(
                f"{path} is a dataset and no run folder: `recon fit {path}` makes one from it, "
                f"`phantomgen view {path}` shows the dataset"
            )
        raise DatasetError(f"{path} is a file and no run folder: `recon fit` makes one from a dataset")


def check_run_name(path: Path, option: str = "--out") -> None:
    """Refuse the name of a file for a folder that is to be written.

    Parameters
    ----------
    path : name of the output
    option : that names it, for the message

    Raises
    ------
    DatasetError
        When the name ends as that of a file.
    """
    if path.suffix.lower() in {".h5", ".hdf5", ".nxs", ".yaml", ".html", ".png", ".json", ".vti", ".nii", ".ply"}:
        raise DatasetError(f"{option} names a folder, got {path}: write {path.with_suffix('')}, for example")


@dataclass(frozen=True)
class RepeatedRun:
    """How a run is reconstructed anew.

    Parameters
    ----------
    dataset : the scan, where the user named it
    air : part of the panel that sees only air
    seed : of the noise
    threads : number of threads; None for all
    quiet, as_json : as in `phantomgen.cli.common.Printing`
    """

    dataset: Path | None
    air: str | None
    seed: int
    threads: int | None
    quiet: bool
    as_json: bool

    @property
    def silent(self) -> bool:
        """Whether no progress is shown."""
        return self.quiet or self.as_json


def repeated_run_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of commands that reconstruct a run anew.

    Parameters
    ----------
    command : function with the parameter ``again``, a `RepeatedRun`

    Returns
    -------
    the function
    """
    command = grouped(again=RepeatedRun)(command)
    options = (
        click.option(
            "--dataset",
            type=click.Path(dir_okay=False, path_type=Path),
            help="The scan [default: by its name, beside the run or here].",
        ),
        click.option("--air", metavar="ROWS,COLUMNS", help="Part of the panel that sees only air, for lack of flats."),
        click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the noise."),
        click.option("--threads", type=click.IntRange(min=1), help="Number of threads [default: all]."),
        progress_options,
        json_option,
        debug_option,
    )
    for option in reversed(options):
        command = option(command)
    return command


def scan_of_run(run: Path, dataset: Path | None) -> Path:
    """Find the scan that a run was made from.

    Parameters
    ----------
    run : run folder
    dataset : the scan, where the user named it

    Returns
    -------
    path of the scan

    Raises
    ------
    DatasetError
        When the folder is no finished run, or the scan is not found.
    """
    from recon.runs.read_run import check_run_folder, dataset_name, find_dataset

    check_run_folder(run)
    name = dataset_name(run)
    path = dataset or find_dataset(name, [run])
    if path is None:
        raise DatasetError(f"the dataset {name or 'of the run'} is neither beside {run} nor here: name it by --dataset")
    return path
