"""Files of a run folder that later commands read: the model, and ``scan.json``, the record of the scan."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from phantomgen.geometry.voxel_grid import Grid
from phantomgen.runtime.plain_json import write_json
from recon.gaussians.divided.model_file import load_model
from recon.gaussians.model import GaussianModel
from spectra.basis.basis import Basis
from spectra.errors import DatasetError
from spectra.transmission import Transmission

MODEL, SCAN = "model.safetensors", "scan.json"
VOLUMES, VIEWS = "volumes.h5", "views.h5"  # the second in place of the first for methods without volumes


@dataclass(frozen=True, eq=False)
class ScanRecord:
    """Record of the scan in a run folder.

    Parameters
    ----------
    grid : of the dataset
    basis : functions of energy; those of a model are the first
    transmission : spectral model of a pixel at the panel's centre, at exposure 1
    """

    grid: Grid
    basis: Basis
    transmission: Transmission


@dataclass(frozen=True, eq=False)
class Run:
    """Fitted Gaussians with the record of their scan.

    Parameters
    ----------
    gaussians : the model
    grid : of the dataset
    basis : functions of energy; those of the model are the first
    transmission : spectral model of a pixel at the panel's centre, at exposure 1; `columns` are those of the model
    """

    gaussians: GaussianModel
    grid: Grid
    basis: Basis
    transmission: Transmission


def write_scan(folder: Path, grid: Grid, basis: Basis, transmission: Transmission, channels: tuple[str, ...]) -> None:
    """Write the record of a scan into a run folder.

    Parameters
    ----------
    folder : run folder
    grid : of the dataset
    basis : functions of energy; those of the model are the first
    transmission : spectral model of a pixel at the panel's centre, at exposure 1
    channels : their names
    """
    table = basis.to_dict()
    nodes = {name: getattr(transmission, name).tolist() for name in ("columns", "weights", "starts")}
    content = {"grid": asdict(grid), "basis": table, "channels": list(channels), "transmission": nodes}
    write_json(folder / SCAN, content)


def open_run(folder: Path) -> Run:
    """Read the Gaussians of a run folder, and the record of their scan.

    Parameters
    ----------
    folder : run folder

    Returns
    -------
    Gaussians and scan

    Raises
    ------
    DatasetError
        When it is no run folder, has no Gaussians, or a file in it is damaged.
    """
    if not (folder / MODEL).is_file():
        if (folder / VOLUMES).is_file():
            raise DatasetError(
                f"{folder} is a run in voxels, but Gaussians are needed: `recon export` writes its volumes"
            )
        raise DatasetError(f"{folder} is not a run folder: it has no {MODEL}; make one by recon fit")
    gaussians = load_model(folder / MODEL)
    scan = open_scan(folder, len(gaussians.basis_names))
    return Run(gaussians, scan.grid, scan.basis, scan.transmission)


def open_scan(folder: Path, bases: int | None = None) -> ScanRecord:
    """Read the record of a scan, as `write_scan` wrote it.

    Parameters
    ----------
    folder : run folder
    bases : number of columns of `transmission` to keep; None for all

    Returns
    -------
    the record

    Raises
    ------
    DatasetError
        When the file is missing, was written by another version, or is damaged.
    """
    try:
        content = json.loads((folder / SCAN).read_text(encoding="utf-8"))
        grid = Grid(**{name: tuple(values) for name, values in content["grid"].items()})
        basis = Basis.from_table({name: _back(name, values) for name, values in content["basis"].items()})
        nodes = {name: np.array(values) for name, values in content["transmission"].items()}
        if not all(np.isfinite(values).all() for values in nodes.values()):
            raise ValueError("the spectral model holds a value that is not a number")
        columns = nodes["columns"][:bases]
        transmission = Transmission(columns, nodes["weights"], nodes["starts"], tuple(content["channels"]))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
        raise DatasetError(f"{folder / SCAN} cannot be read as what recon fit writes there ({error})") from error
    return ScanRecord(grid, basis, transmission)


def _back(name: str, value: Any) -> Any:
    """Arrays of numbers with NaN for null, other values as they are."""
    numbers = name in ("edge_energy", "edge_width", "normalisation_energy")
    return np.array([np.nan if number is None else number for number in value]) if numbers else value
