"""The log of a voxel or view method: residual of every iteration, and some volumes between them."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from phantomgen.geometry.voxel_grid import Grid
from phantomgen.runtime.plain_json import to_json
from recon.runs.unfinished_run import LOG
from recon.voxel.method import Iteration
from recon.voxel.model import Voxels

SNAPSHOTS = 10  # volumes; kept for curves of error against time; memory is as many times that of the result


class IterationLog:
    """Log of a voxel or view method; seconds count from when it is made.

    Parameters
    ----------
    folder : run folder, where ``log.jsonl`` is written; None for no file
    grid : of the result; volumes of coarser passes are not kept
    names : of the bases

    Attributes
    ----------
    entries : number, seconds and residual of each iteration
    """

    def __init__(self, folder: Path | None, grid: Grid, names: tuple[str, ...]) -> None:
        self.folder, self.grid, self.names = folder, grid, names
        self.entries: list[dict[str, Any]] = []
        self._volumes: dict[int, np.ndarray] = {}
        self._began = time.perf_counter()

    def add(self, iteration: Iteration) -> None:
        """Add an iteration, and keep its volumes where a tenth of all iterations has passed.

        Parameters
        ----------
        iteration : finished iteration
        """
        seconds = time.perf_counter() - self._began
        self.entries.append({"iteration": iteration.done, "seconds": seconds, "residual": iteration.residual})
        last = self.entries[-2]["iteration"] if len(self.entries) > 1 else 0
        every = max(iteration.total // SNAPSHOTS, 1)
        due = iteration.done // every > last // every or iteration.done == iteration.total
        if due and iteration.views is None and iteration.volumes.shape[1:] == self.grid.shape:
            self._volumes[iteration.done] = iteration.volumes.copy()

    def models(self) -> Iterator[tuple[int, Voxels]]:
        """Yield the volumes that were kept.

        Yields
        ------
        number of the iteration, and its volumes
        """
        for done, volumes in self._volumes.items():
            yield done, Voxels(volumes, self.grid, self.names)

    def write(self) -> None:
        """Write one JSON object per iteration."""
        if self.folder is not None:
            text = "".join(to_json(entry) + "\n" for entry in self.entries)
            (self.folder / LOG).write_text(text, encoding="utf-8")

    def add_scores(self, scores: dict[int, dict[str, float]]) -> None:
        """Add scores to the entries of their iterations, and write them.

        Parameters
        ----------
        scores : by number of the iteration, such as ``psnr_compton`` [dB]
        """
        for entry in self.entries:
            entry.update(scores.get(entry["iteration"], {}))
        self.write()
