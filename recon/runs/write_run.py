"""Writing a run folder: how it gets its name, its volumes, and its scores as text."""

import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.checks.door import array_at
from phantomgen.dataset.layout import new_group, put
from phantomgen.dataset.truth import write_grid
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.runtime.disk import one_sentence
from phantomgen.runtime.output_lock import acquire
from phantomgen.runtime.outputs import check_name, check_output_folder, refuse_interrupted
from recon.evaluation.quantities import UNITS
from recon.runs.run_folder import MODEL, VIEWS, VOLUMES
from recon.runs.unfinished_run import clear, is_partial
from recon.voxel.unreliable import Unreliable
from spectra.errors import InputError, StorageError

if TYPE_CHECKING:
    import h5py


class RunFolder:
    """Run folder that gets its name when it is complete; use it in a ``with`` statement.

    Until then it is ``<path>.part``. After an interruption or an error it stays there with a checkpoint, if the fit had
    begun; a fit that Ctrl-C ended after a step gets its name, unless another run has it.

    Parameters
    ----------
    path : name of the folder
    overwrite : replace a folder that exists, and begin anew where an interrupted run left a checkpoint
    resume : go on from that checkpoint, if there is one

    Raises
    ------
    InputError
        When the folder exists and `overwrite` is not given, when what is there was not written by a run, when an
        interrupted run is there and neither is given, or when the folder cannot be made.
    """

    def __init__(self, path: Path, overwrite: bool, resume: bool = False) -> None:
        check_name(path)
        self.path, self.resume = path, resume
        self.part = path.absolute().with_name(path.absolute().name + ".part")
        interrupted = is_partial(path) and not path.is_symlink()
        if interrupted:
            refuse_interrupted(path, resume, overwrite)
        check_output_folder(path, overwrite or interrupted, "recon", _is_run)
        if self.part.exists() and not (self.part / "figures").is_dir():
            raise InputError(f"{self.part} is in the way and was not written by recon: move it, or choose another name")
        if is_partial(self.part):
            refuse_interrupted(self.part, resume, overwrite)

    def __enter__(self) -> Path:
        with one_sentence(self.path):
            self._lock = acquire(self.path)
        try:
            if self.resume and is_partial(self.path) and not is_partial(self.part):
                shutil.rmtree(self.part, ignore_errors=True)
                os.replace(self.path, self.part)
            elif not (self.resume and is_partial(self.part)):
                shutil.rmtree(self.part, ignore_errors=True)
            (self.part / "figures").mkdir(parents=True, exist_ok=True)
        except OSError as error:
            self._lock.unlink(missing_ok=True)
            raise InputError(f"{self.part} cannot be written: {error.strerror}") from None
        return self.part

    def __exit__(self, kind: type | None, error: object, traceback: object) -> None:
        try:
            self._finish(kind, error)
        finally:
            self._lock.unlink(missing_ok=True)

    def _finish(self, kind: type | None, error: object) -> None:
        """Name the folder, or keep what can be resumed."""
        if kind is None:
            if self.path.exists():
                shutil.rmtree(self.path)
            os.replace(self.part, self.path)
            clear(self.path)
        elif kind is Stopped:
            onward = ": go on by --resume" if is_partial(self.part) else ""
            place = self.part if self.path.exists() else self.path
            if place is self.path:
                os.replace(self.part, self.path)
            raise KeyboardInterrupt(f"{place} holds the model {error}, not yet scored{onward}")
        elif not is_partial(self.part):
            shutil.rmtree(self.part, ignore_errors=True)
        elif kind is not None and issubclass(kind, StorageError):
            raise StorageError(f"{error}; what was fitted is kept in {self.part}: go on by --resume") from None
        elif kind is not None and issubclass(kind, KeyboardInterrupt):
            raise kind(f"what was fitted is kept in {self.part}: go on by --resume")


def _is_run(path: Path) -> bool:
    """Whether a run wrote a folder: stopped runs have no volumes, voxel methods no Gaussians, some only views."""
    return (path / "metrics.json").is_file() and any((path / n).is_file() for n in (MODEL, VOLUMES, VIEWS))


class Stopped(KeyboardInterrupt):
    """Signal that Ctrl-C ended a fit after a step, and that its model is written."""


def write_volumes(
    path: Path,
    volumes: Float[np.ndarray, "basis z y x"],
    names: tuple[str, ...],
    grid: Grid,
    others: dict[str, Float[np.ndarray, "basis z y x"]],
    unreliable: Unreliable | None = None,
    unit: str = "1/mm",
) -> None:
    """Write volumes as NeXus plots with axes in mm.

    Parameters
    ----------
    path : HDF5 file
    volumes : basis coefficients [1/mm], written as ``/basis/data``
    names : of the bases
    grid : of all volumes
    others : further volumes [1/mm], by the name of their group
    unreliable : voxels whose bases the counts do not determine, written as flags ``/unreliable/data``; None for no such
        group
    unit : of the volumes
    """
    from phantomgen.runtime.hdf5_output import hdf5_output  # noqa: PLC0415 - h5py

    with hdf5_output(path) as file:
        file.attrs.update({"NX_class": "NXroot", "default": "basis", "creator": "recon"})
        for name, values in (("basis", volumes), *others.items()):
            group = _plot(file, name, values.astype(np.float32), ("basis_name", "z", "y", "x"), grid)
            array_at(group, "data").attrs["units"] = unit
            put(group, "basis_name", np.array(names, dtype=object))
        if unreliable is not None:
            _plot(file, "unreliable", unreliable.flags, ("z", "y", "x"), grid)
        write_grid(new_group(file, "grid", "NXcollection"), grid)


def _plot(file: "h5py.File", name: str, values: np.ndarray, axes: tuple[str, ...], grid: Grid) -> "h5py.Group":
    """Write an array of voxels as a NeXus plot, compressed slice by slice."""
    group = new_group(file, name, "NXdata", signal="data", axes=axes)
    chunks = (*[1] * (values.ndim - 2), *values.shape[-2:])
    group.create_dataset(
        "data", data=values, chunks=chunks, compression="gzip", compression_opts=1, shuffle=True, fletcher32=True
    )
    for axis in "zyx":
        put(group, axis, grid.axis(axis), "mm")
    return group


def score_table(metrics: dict[str, Any]) -> str:
    """Format the scores as text.

    Parameters
    ----------
    metrics : content of ``metrics.json``

    Returns
    -------
    tables with a row per basis, or per volume of attenuation, density or fractions, and a row per channel; empty
    without scores
    """
    volumes = (_basis_table(metrics, group) for group in UNITS)
    return "\n\n".join(part for part in (*volumes, _channel_table(metrics)) if part)


def _basis_table(metrics: dict[str, Any], group: str) -> str:
    """Scores against the truth, of the start of the fit and of a volume of zeros beside them."""
    if group not in metrics:
        return ""
    wide = max(16, *(len(name) + 2 for name in metrics[group]))
    method = metrics.get("start", "")
    start = metrics.get(method, {})
    shown = f"{method:>10}" if method else ""
    rest = any("psnr_elsewhere" in s for s in metrics[group].values())
    unit = UNITS[group]
    header = f"{group:<{wide}}{'PSNR':>8}{'elsewhere' if rest else '':>{11 * rest}}{'SSIM':>8}{shown}"
    header += f"{'zero volume':>13}{'bias':>12}{'RMSE':>11}"
    units = f"{'dB, ' * rest}dB, -, {'dB, ' if method else ''}dB, {unit}, {unit}"
    lines = [f"{header}   [{units}]"]
    for name, s in metrics[group].items():
        lines.append(
            f"{name:<{wide}}{_number(s['psnr'], '8.2f')}{_number(s.get('psnr_elsewhere'), '11.2f') if rest else ''}"
            f"{_number(s['ssim'], '8.3f')}"
            f"{_number(start.get(name, {}).get('psnr'), '10.2f') if method else ''}{_number(s['psnr_zero'], '13.1f')}"
            f"{_number(s['bias'], '12.1e')}{_number(s['rmse'], '11.1e')}"
        )
    return "\n".join(lines)


def _channel_table(metrics: dict[str, Any]) -> str:
    """Scores on test views."""
    if not metrics.get("channels"):
        return ""
    header = f"{'test views':<16}{'PSNR':>8}{'chi-square':>12}{'off edges':>11}"
    lines = [f"{header}   [dB of log projections, -, -]"]
    for name, s in metrics["channels"].items():
        lines.append(
            f"{name:<16}{_number(s['psnr'], '8.2f')}{_number(s['chi_square_all'], '12.3f')}"
            f"{_number(s['chi_square_away'], '11.3f')}"
        )
    return "\n".join(lines)


def _number(value: float | None, layout: str) -> str:
    width = int(layout.split(".", maxsplit=1)[0])
    return format(value, layout) if value is not None else "-".rjust(width)
