"""Sums over the views of a dataset that corrections are computed from; two passes, one view in memory at a time."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from phantomgen.correction.bad_pixels import PixelStatistics
from phantomgen.correction.tube_output import BlockSums
from phantomgen.dataset.reader import Dataset

BLOCK = 8  # pixels along each side of a block
RUNS = 16  # runs of neighbouring views, at most; a quarter of the views at most


@dataclass(frozen=True, eq=False)
class ScanSums:
    """Sums of one dataset.

    Parameters
    ----------
    dataset : open dataset
    on_view : called after each view that is read
    """

    dataset: Dataset
    on_view: Callable[[], object] = lambda: None

    @cached_property
    def unit(self) -> Float[np.ndarray, "channel 1 1"]:
        """Signal of a quantum of each channel; 1 for counts."""
        return self.dataset.spectra.quantum[:, None, None]

    @cached_property
    def air(self) -> Float[np.ndarray, "channel row column"]:
        """Open beam, darks subtracted and dead time corrected."""
        return self.dataset.spectra.events(self.dataset.flat)

    def signal(self, view: int) -> Float[np.ndarray, "channel row column"]:
        """Read a view, darks subtracted and dead time corrected.

        Parameters
        ----------
        view : number of the view

        Returns
        -------
        the signal
        """
        return self.dataset.spectra.events(self.dataset.load([view])[0] - self.dataset.dark)

    def statistics(self) -> list[PixelStatistics]:
        """Compute mean and variance between views of each pixel of each channel.

        Returns
        -------
        statistics of each channel
        """
        dataset, shape = self.dataset, self.dataset.counts.shape[1:]
        total, squares, views = np.zeros(shape), np.zeros(shape), np.zeros(shape[0])
        first = np.zeros(shape)  # squares of differences from the first view keep their digits
        for view, exposure in enumerate(dataset.exposure):
            read = (dataset.load([view])[0] - dataset.dark) / self.unit
            taken = exposure > 0
            first[taken & (views == 0)] = read[taken & (views == 0)]
            total[taken] += (read - first)[taken]
            squares[taken] += np.square(read - first)[taken]
            views += taken
            self.on_view()
        count = np.maximum(views, 1)[:, None, None]
        mean = total / count
        variance = np.maximum(squares / count - mean**2, 0) * count / np.maximum(count - 1, 1)
        air, dark = dataset.flat / self.unit, dataset.dark / self.unit
        mean = mean + first
        return [
            PixelStatistics(air[channel], dark[channel], mean[channel], variance[channel], int(count))
            for channel, count in enumerate(views)
        ]

    def blocks_and_runs(
        self, measures: Bool[np.ndarray, "channel row column"]
    ) -> tuple[BlockSums, Float[np.ndarray, "run channel row column"], list[np.ndarray]]:
        """Sum views over blocks of pixels, and pixels over runs of views.

        Parameters
        ----------
        measures : pixels that measure

        Returns
        -------
        sums of blocks, sums of runs in the units of the detector, and the views of each run
        """
        dataset = self.dataset
        views, _, rows, columns = dataset.counts.shape
        runs = np.array_split(np.arange(views), max(min(RUNS, views // 4), 1))
        places = np.arange(0, rows, BLOCK), np.arange(0, columns, BLOCK)
        of_runs = np.zeros((len(runs), *dataset.counts.shape[1:]))
        counts, air = [], []
        for number, run in enumerate(runs):
            for view in run:
                seen, exposed = self.signal(int(view)), dataset.exposure[view][:, None, None]
                of_runs[number] += np.where(exposed > 0, seen, 0)
                used = measures & (exposed > 0)
                counts.append(_in_blocks(np.sum(seen / self.unit, axis=0, where=used), *places))
                air.append(_in_blocks(np.sum(self.air * exposed / self.unit, axis=0, where=used), *places))
                self.on_view()
        return BlockSums(np.stack(counts), np.stack(air)), of_runs, runs


def _in_blocks(image: Float[np.ndarray, "row column"], rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Sums over blocks that begin at these rows and columns, in one list."""
    return np.ravel(np.add.reduceat(np.add.reduceat(image, rows, axis=0), columns, axis=1))
