"""Interruption of a run, and the files that it leaves: start and state of the fit, its log, and models between steps.

A fit can be resumed from these files after `kill -9` at any moment. The log may be a few steps ahead of the last
checkpoint; those lines are removed, and written again when the steps are repeated.
"""

import json
import shutil
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from phantomgen.runtime.plain_json import to_json
from recon.data.measurements import Measurements
from recon.gaussians.divided.model_file import load_model
from recon.gaussians.model import GaussianModel
from recon.gaussians.optimize import Progress
from recon.gaussians.state import FitState, InterruptedFit
from recon.runs.checkpoint import identity, read_checkpoint, write_checkpoint, write_whole
from spectra.errors import InputError

START, CHECKPOINT, LOG, SNAPSHOTS = "start.safetensors", "checkpoint.safetensors", "log.jsonl", "snapshots"
EVERY = 30.0  # s; time between two checkpoints, the most that `kill -9` costs
_SIGNALS = (signal.SIGINT, signal.SIGTERM)  # torchrun and batch systems send the second


class Interruption:
    """Context in which the first Ctrl-C or SIGTERM sets `asked`, and the next one ends the process at once.

    Outside the main thread, where Python handles no signals, it does nothing.

    Attributes
    ----------
    asked : whether a signal has come
    """

    def __init__(self) -> None:
        self.asked = False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> "Interruption":
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._ask) for number in _SIGNALS}
        return self

    def __exit__(self, *exception: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _ask(self, number: int, frame: FrameType | None) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True


def is_partial(folder: Path) -> bool:
    """Tell whether a folder holds a fit that can be resumed.

    Parameters
    ----------
    folder : any path

    Returns
    -------
    True where it holds the start and the state of a fit
    """
    return all((folder / name).is_file() for name in (START, CHECKPOINT))


def clear(folder: Path) -> None:
    """Remove the files that only an unfinished run needs.

    Parameters
    ----------
    folder : run folder
    """
    shutil.rmtree(folder / SNAPSHOTS, ignore_errors=True)
    for name in (CHECKPOINT, START):
        (folder / name).unlink(missing_ok=True)


class PartialRun:
    """Folder of a run that is not finished; a `recon.gaussians.reconstruct.CheckpointStore`.

    Parameters
    ----------
    folder : existing folder
    channels : names of the channels, for the log
    options : settings that results depend on beside the dataset, by the names that a message shows

    Attributes
    ----------
    log : one entry per step
    """

    def __init__(self, folder: Path, channels: tuple[str, ...], options: dict[str, Any]) -> None:
        self.folder, self.channels, self.options = folder, channels, options
        self.log: list[dict[str, Any]] = []
        self._saved = time.perf_counter()

    def found(self, measured: Measurements) -> InterruptedFit | None:
        """Read the state of an interrupted fit.

        Parameters
        ----------
        measured : training views of the fit that is to be resumed

        Returns
        -------
        state of the fit, volumes that it started from [1/mm], and time of its stages [s]; None where there is no such
        fit

        Raises
        ------
        InputError
            When it was begun with another dataset or other options.
        """
        self._identity = identity(measured, self.options)
        if not is_partial(self.folder):
            return None
        start, content = read_checkpoint(self.folder / START)
        self._check(content["identity"])
        state = FitState.restore(*read_checkpoint(self.folder / CHECKPOINT))
        self._read_log(state.done)
        return InterruptedFit(state, start["volumes"].numpy(), content["seconds"])

    def begin(self, volumes: Float[np.ndarray, "basis z y x"], seconds: dict[str, float], state: FitState) -> None:
        """Write the start of a fit.

        Parameters
        ----------
        volumes : those that it starts from [1/mm]
        seconds : time of the stages of the start [s]
        state : of the fit before its first step
        """
        content = {"identity": self._identity, "seconds": seconds}
        write_checkpoint(self.folder / START, {"volumes": torch.from_numpy(volumes)}, content)
        (self.folder / LOG).write_bytes(b"")
        self.save(state)

    def add(self, progress: Progress) -> None:
        """Write the line of a step to the log, and after some steps the model and a checkpoint.

        Parameters
        ----------
        progress : finished step
        """
        if progress.step <= len(self.log):  # the fit has begun anew, see `recon.gaussians.optimize`
            self.log.clear()
            (self.folder / LOG).write_bytes(b"")
            shutil.rmtree(self.folder / SNAPSHOTS, ignore_errors=True)
        entry = log_entry(progress, self.channels)
        self.log.append(entry)
        with (self.folder / LOG).open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry) + "\n")
        if progress.snapshot:
            (self.folder / SNAPSHOTS).mkdir(exist_ok=True)
            progress.gaussians.save(self._snapshot(progress.step))
        due = progress.step == progress.steps or time.perf_counter() - self._saved > EVERY
        if progress.state is not None and due:
            self.save(progress.state)

    def save(self, state: FitState) -> None:
        """Write a checkpoint.

        Parameters
        ----------
        state : of the fit
        """
        write_checkpoint(self.folder / CHECKPOINT, state.tensors(), state.numbers())
        self._saved = time.perf_counter()

    def snapshots(self) -> dict[int, Path]:
        """List the files of the models that were kept between steps.

        Returns
        -------
        files by number of the step
        """
        found = {int(entry["step"]): self._snapshot(int(entry["step"])) for entry in self.log}
        return {step: path for step, path in found.items() if path.is_file()}

    def models(self) -> Iterator[tuple[int, GaussianModel]]:
        """Load every other one of the models that were kept between steps, with the last one.

        Yields
        ------
        number of the step, and the model after it
        """
        for step, path in list(self.snapshots().items())[::-2][::-1]:
            yield step, load_model(path)

    def add_scores(self, scores: dict[int, dict[str, float]]) -> None:
        """Add scores to the lines of their steps.

        Parameters
        ----------
        scores : by number of the step, such as ``psnr_compton`` [dB]
        """
        lines = [to_json(entry | scores.get(int(entry["step"]), {})) + "\n" for entry in self.log]
        write_whole(self.folder / LOG, "".join(lines).encode())

    def _snapshot(self, step: int) -> Path:
        return self.folder / SNAPSHOTS / f"{step}.safetensors"

    def _check(self, other: dict[str, str]) -> None:
        names = {*other, *self._identity}
        changed = sorted(name for name in names if other.get(name) != self._identity.get(name))
        if changed:
            raise InputError(
                f"{self.folder} cannot be resumed, as it was begun with another {' and '.join(changed)}: "
                "ask for the same, or begin anew by --overwrite"
            )

    def _read_log(self, done: int) -> None:
        """Read the lines of the steps before the checkpoint, and remove later ones, of which the last may be torn."""
        lines = (self.folder / LOG).read_text(encoding="utf-8").splitlines()[:done]
        self.log = [json.loads(line) for line in lines]
        write_whole(self.folder / LOG, "".join(line + "\n" for line in lines).encode())


def log_entry(progress: Progress, channels: tuple[str, ...]) -> dict[str, Any]:
    """Return the entry of a step in the log.

    Parameters
    ----------
    progress : finished step
    channels : names of the channels

    Returns
    -------
    number, seconds, deviance, and chi-square of each channel, of held-out rays, too, where there are any
    """
    entry: dict[str, Any] = {"step": progress.step, "seconds": progress.seconds, "deviance": progress.deviance}
    entry |= _per_channel("chi_square", progress.chi_square, channels)
    if progress.held_out is not None:
        entry |= _per_channel("held_out_chi_square", progress.held_out, channels)
    return entry


def _per_channel(
    name: str, values: Float[np.ndarray, " channel"], channels: tuple[str, ...]
) -> dict[str, float | None]:
    """Entries of the log; None where a channel has no value, as JSON has no NaN."""
    pairs = zip(channels, values.tolist(), strict=True)
    return {f"{name}_{channel}": value if np.isfinite(value) else None for channel, value in pairs}
