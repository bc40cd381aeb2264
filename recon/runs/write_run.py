"""The run folder: model, volumes, metrics, log and figures of one fit."""

import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.layout import new_group, put
from phantomgen.dataset.truth import write_grid
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.runtime.outputs import check_output_folder, refuse_interrupted
from recon.runs.run_folder import MODEL, VIEWS, VOLUMES
from recon.runs.unfinished_run import clear, is_partial
from recon.voxel.unreliable import Unreliable
from spectra.errors import InputError


class RunFolder:
    """A folder that appears under its name when it is complete; use it in a ``with`` statement.

    Until then it is ``<path>.part``. An interruption or a fault leaves that there with a checkpoint, if the fit had
    begun; a fit that stopped cleanly at Ctrl-C gets its name, unless another run has it.

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
        try:
            if self.resume and is_partial(self.path) and not is_partial(self.part):
                shutil.rmtree(self.part, ignore_errors=True)
                os.replace(self.path, self.part)
            elif not (self.resume and is_partial(self.part)):
                shutil.rmtree(self.part, ignore_errors=True)
            (self.part / "figures").mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{self.part} cannot be written: {error.strerror}") from None
        return self.part

    def __exit__(self, kind: type | None, error: object, traceback: object) -> None:
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
        elif kind is KeyboardInterrupt:
            raise KeyboardInterrupt(f"what was fitted is kept in {self.part}: go on by --resume")


def _is_run(path: Path) -> bool:
    """Whether a folder was written by a run; stopped ones lack volumes, voxel methods a model, some have views only."""
    return (path / "metrics.json").is_file() and any((path / n).is_file() for n in (MODEL, VOLUMES, VIEWS))


class Stopped(KeyboardInterrupt):
    """A fit stopped after a step, as it was asked to, and left its model."""


def write_volumes(
    path: Path,
    volumes: Float[np.ndarray, "basis z y x"],
    names: tuple[str, ...],
    grid: Grid,
    others: dict[str, Float[np.ndarray, "basis z y x"]],
    unreliable: Unreliable | None = None,
) -> None:
    """Write ``/basis/data`` [1/mm] as a NeXus plot with axes in mm, and `others` beside it, by their name.

    Flags of `unreliable` voxels are ``/unreliable/data``, which is left out where there are none.
    """
    import h5py  # noqa: PLC0415

    with h5py.File(path, "w") as file:
        file.attrs.update({"NX_class": "NXroot", "default": "basis", "creator": "recon"})
        for group_name, values in (("basis", volumes), *others.items()):
            group = new_group(file, group_name, "NXdata", signal="data", axes=("basis_name", "z", "y", "x"))
            data = group.create_dataset(
                "data", data=values.astype(np.float32), chunks=(1, 1, *values.shape[2:]), compression="gzip",
                compression_opts=1, shuffle=True,
            )  # fmt: skip
            data.attrs["units"] = "1/mm"
            put(group, "basis_name", np.array(names, dtype=object))
            for axis in "zyx":
                put(group, axis, grid.axis(axis), "mm")
        if unreliable is not None:
            group = new_group(file, "unreliable", "NXdata", signal="data", axes=("z", "y", "x"))
            chunks = (1, *unreliable.flags.shape[1:])
            group.create_dataset("data", data=unreliable.flags, chunks=chunks, compression="gzip", compression_opts=1)
            for axis in "zyx":
                put(group, axis, grid.axis(axis), "mm")
        write_grid(new_group(file, "grid", "NXcollection"), grid)


def score_table(metrics: dict[str, Any]) -> str:
    """The scores as text: one row per basis, one per channel."""
    return "\n\n".join(part for part in (_basis_table(metrics), _channel_table(metrics)) if part)


def _basis_table(metrics: dict[str, Any]) -> str:
    """Scores against the truth, beside those of the volumes that the fit started from and of a volume of zeros."""
    if "basis" not in metrics:
        return ""
    method = metrics.get("start", "")
    start = metrics.get(method, {})
    shown = f"{method:>10}" if method else ""
    rest = any("psnr_elsewhere" in s for s in metrics["basis"].values())
    header = f"{'basis':<16}{'PSNR':>8}{'elsewhere' if rest else '':>{11 * rest}}{'SSIM':>8}{shown}"
    header += f"{'zero volume':>13}{'bias':>12}{'RMSE':>11}"
    units = f"{'dB, ' * rest}dB, -, {'dB, ' if method else ''}dB, 1/mm, 1/mm"
    lines = [f"{header}   [{units}]"]
    for name, s in metrics["basis"].items():
        lines.append(
            f"{name:<16}{_number(s['psnr'], '8.2f')}{_number(s.get('psnr_elsewhere'), '11.2f') if rest else ''}"
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
