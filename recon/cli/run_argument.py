"""The argument RUN of commands: a run folder, and messages for paths that are none."""

from pathlib import Path
from typing import Any

import click

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
