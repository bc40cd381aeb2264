"""Volumes of attenuation per channel, the result of methods that reconstruct channels one by one."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.reader import Dataset
from phantomgen.geometry.curved_panel import module_frames
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.project import project
from recon.data.measurements import read_measurements
from recon.evaluation.count_noise import CountNoise
from recon.evaluation.metrics import HeldOutView
from recon.evaluation.scoring import VIEWS_AT_ONCE


@dataclass(frozen=True, eq=False)
class ChannelVoxels:
    """Attenuation of every channel on one grid.

    Parameters
    ----------
    values : attenuation that the log projections of the channel give [1/mm]
    grid : of the voxels
    """

    values: Float[np.ndarray, "channel z y x"]
    grid: Grid

    def held_out_views(self, dataset: Dataset) -> Iterator[HeldOutView]:
        """Yield the test views of a dataset beside their prediction: open beam times exp(-line integral).

        Parameters
        ----------
        dataset : open dataset

        Yields
        ------
        measured and predicted counts of a view
        """
        test, panel, noise = dataset.splits["test"], dataset.geometry.panel, CountNoise.of(dataset)
        for first in range(0, len(test), VIEWS_AT_ONCE):
            measured = read_measurements(dataset, test[first : first + VIEWS_AT_ONCE], 1)
            frames = module_frames(measured.geometry)
            lengths = np.moveaxis(project(self.values, self.grid, frames, panel.rows, panel.columns), 0, 1)
            open_beam = measured.exposure[:, :, None, None] * (measured.gains * measured.open_beam)
            for counts, air, length in zip(measured.counts, open_beam, lengths, strict=True):
                expected = air * np.exp(-length)
                yield HeldOutView.of(counts, expected, air, spread=noise.spread(expected))
