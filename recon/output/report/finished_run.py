"""Run folder as a report reads it, for all methods."""

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.voxel_grid import Grid
from phantomgen.runtime.versions import program_version
from recon.gaussians.divided.model_file import load_model
from recon.gaussians.model import GaussianModel
from recon.runs.read_run import VOLUMES, read_volumes
from recon.runs.run_folder import MODEL
from recon.voxel.model import Voxels
from spectra.errors import DatasetError


@dataclass(frozen=True, eq=False)
class FinishedRun:
    """Results in a run folder.

    Parameters
    ----------
    folder : run folder
    name : name of the run in the report
    metrics : scores, seconds, memory
    log : one entry per step or iteration
    volumes : coefficients of the bases [1/mm]
    grid : grid of the volumes
    basis_names : names of the bases
    """

    folder: Path
    name: str
    metrics: dict[str, Any]
    log: tuple[dict[str, Any], ...]
    volumes: Float[np.ndarray, "basis z y x"]
    grid: Grid
    basis_names: tuple[str, ...]

    @cached_property
    def model(self) -> GaussianModel | Voxels:
        """Model that predicts projections: the Gaussians, or the voxels of a method without Gaussians."""
        if (self.folder / MODEL).is_file():
            return load_model(self.folder / MODEL)
        return Voxels(self.volumes, self.grid, self.basis_names)

    @property
    def method(self) -> str:
        """Name of the method, and of its pipeline where it has one."""
        settings = self.metrics.get("method")
        if isinstance(settings, dict):
            return " ".join(str(settings[key]) for key in ("method", "pipeline") if key in settings)
        return "Gaussians"

    @property
    def recipe(self) -> str:
        """Settings of the run as YAML; empty where the folder has none."""
        path = self.folder / "recipe.yaml"
        return path.read_text(encoding="utf-8") if path.is_file() else ""

    def volume(self, name: str, grid: Grid) -> Float[np.ndarray, "z y x"]:
        """Return the volume of one basis on a grid.

        Parameters
        ----------
        name : name of the basis
        grid : grid of the volume

        Returns
        -------
        coefficients [1/mm]; zeros for a basis that the run does not have
        """
        if name not in self.basis_names:
            return np.zeros(grid.shape, np.float32)
        basis = self.basis_names.index(name)
        if grid == self.grid:
            return self.volumes[basis]
        return Voxels(self.volumes[basis : basis + 1], self.grid, (name,)).volume(grid)[0]


def open_finished_run(folder: Path, name: str | None = None) -> FinishedRun:
    """Read a run folder.

    Parameters
    ----------
    folder : folder that ``recon fit`` wrote, with any method
    name : name of the run; that of the folder where it is None

    Returns
    -------
    results of the run

    Raises
    ------
    DatasetError
        When it is no run folder, not finished, written by a newer version, or damaged.
    """
    if not (folder / "metrics.json").is_file():
        raise DatasetError(f"{folder} is not a run folder: it has no metrics.json; make one by recon fit")
    metrics = _read_json(folder / "metrics.json")
    if "interrupted" in metrics:
        raise DatasetError(f"{folder} holds a fit that was interrupted and is not scored: finish it by --resume")
    _check_version(folder, metrics)
    if not (folder / VOLUMES).is_file():
        raise DatasetError(f"{folder} is incomplete: it has no {VOLUMES}; repeat recon fit with --overwrite")
    stored = read_volumes(folder / VOLUMES)
    return FinishedRun(
        folder,
        name or folder.resolve().name,
        metrics,
        _read_log(folder),
        stored.values,
        stored.grid,
        stored.basis_names,
    )


def _read_json(path: Path) -> dict[str, Any]:
    """Object in a JSON file."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise DatasetError(f"{path} is damaged: it is not JSON ({error})") from None
    if not isinstance(content, dict):
        raise DatasetError(f"{path} is not what recon fit writes there: expected an object, got {content!r:.40}")
    return content


def _check_version(folder: Path, metrics: dict[str, Any]) -> None:
    """Refuse folders of newer versions, whose files may have another meaning."""
    wrote = str(metrics.get("versions", {}).get("spectral-ct", ""))
    numbers = _numbers(wrote)
    if not numbers:
        raise DatasetError(f"{folder} is of another version: its metrics.json does not name the program that wrote it")
    if program_version() != "0" and numbers[:2] > _numbers(program_version())[:2]:
        raise DatasetError(f"{folder} was written by version {wrote}, this program is {program_version()}: update it")


def _numbers(version: str) -> list[int]:
    """Numbers of a version such as ``1.2.3``."""
    return [int(part) for part in version.split(".")[:3] if part.isdigit()]


def _read_log(folder: Path) -> tuple[dict[str, Any], ...]:
    """Entries of the log, without lines that are no JSON, as the last one of a run that ended early may be cut."""
    path = folder / "log.jsonl"
    if not path.is_file():
        return ()
    entries = []
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            entries.append(json.loads(line))
        except ValueError:
            continue
    return tuple(entries)
