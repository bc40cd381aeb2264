"""Log projections of all channels together, with weights by their counts, in blocks of pixels."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from phantomgen.dataset.reader import Dataset
from phantomgen.geometry.panel_changes import smaller_panel
from phantomgen.geometry.poses import Geometry

# Relative error of a log projection that has another cause than noise, such as voxels, scatter and beam hardening: it
# limits the weight of a ray. Chosen by hand.
MODEL_ERROR = 0.01
# Counts of all channels together below which a ray says nothing. Chosen by hand.
LEAST_COUNTS = 1.0


@dataclass(frozen=True, eq=False)
class SummedCounts:
    """Counts of all channels together, and what they are in the open beam.

    Parameters
    ----------
    counts : measured, darks subtracted
    air : in the open beam, at the exposure of each view; 0 where no channel of a pixel measures
    geometry : stated poses of these views
    """

    counts: Float32[np.ndarray, "view row column"]
    air: Float32[np.ndarray, "view row column"]
    geometry: Geometry

    @classmethod
    def of(cls, dataset: Dataset, views: Int[np.ndarray, " some"]) -> "SummedCounts":
        """Read some views of a dataset.

        Parameters
        ----------
        dataset : open dataset
        views : their numbers

        Returns
        -------
        the counts
        """
        shape = (len(views), *dataset.counts.shape[2:])
        counts, air = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        unit = dataset.spectra.quantum[:, None, None]
        beam = dataset.spectra.events(dataset.flat) / unit
        measures = ~dataset.mask & (beam > 0)
        even = _evened(beam, measures)
        for place, view in enumerate(views):
            seen = dataset.spectra.events(dataset.load([int(view)])[0] - dataset.dark)
            exposed = dataset.exposure[view][:, None, None]
            used = measures & (exposed > 0)
            counts[place] = np.sum(seen / unit * even, axis=0, where=used)
            air[place] = np.sum(beam * exposed * even, axis=0, where=used)
        return cls(counts, air, dataset.geometry[views])

    def some_views(self, views: Int[np.ndarray, " some"]) -> "SummedCounts":
        """Return some of the views.

        Parameters
        ----------
        views : their places

        Returns
        -------
        the counts of these views
        """
        return SummedCounts(self.counts[views], self.air[views], self.geometry[views])

    def binned(self, factor: int) -> "SummedCounts":
        """Sum blocks of pixels; rows and columns that do not fill a block are left out, as many at both ends.

        Parameters
        ----------
        factor : pixels along each side of a block

        Returns
        -------
        counts on the panel of larger pixels
        """
        rows, columns = (_middle(n, factor) for n in self.counts.shape[1:])
        geometry = smaller_panel(self.geometry, columns, factor, rows)

        def summed(images: Float32[np.ndarray, "view row column"]) -> Float32[np.ndarray, "view row column"]:
            views, height, width = images[:, rows, columns].shape
            blocks = images[:, rows, columns].reshape(views, height // factor, factor, width // factor, factor)
            return blocks.sum(axis=(2, 4))

        return replace(self, counts=summed(self.counts), air=summed(self.air), geometry=geometry)

    def logs_and_weights(
        self,
    ) -> tuple[Float32[np.ndarray, "view row column"], Float32[np.ndarray, "view row column"]]:
        """Compute log projections and their weights.

        The weight is the inverse of the variance ``1 / counts + MODEL_ERROR**2``, 0 where a pixel does not measure.

        Returns
        -------
        log projections [no unit], and weights
        """
        counts, seen = np.maximum(self.counts, LEAST_COUNTS), self.air > 0
        logs = np.where(seen, np.log(np.where(seen, self.air, 1) / counts), 0)
        weights = np.where(seen & (self.counts >= LEAST_COUNTS), 1 / (1 / counts + MODEL_ERROR**2), 0)
        return logs.astype(np.float32), weights.astype(np.float32)


def _evened(
    beam: Float[np.ndarray, "channel row column"], measures: Bool[np.ndarray, "channel row column"]
) -> Float[np.ndarray, "channel row column"]:
    """Factors that give the channels of every pixel the same shares of the open beam, with its sum unchanged.

    Channels with gains of their own would otherwise make up another spectrum in every pixel.
    """
    shares = np.array([np.median(one[used]) if used.any() else 0.0 for one, used in zip(beam, measures, strict=True)])
    share = shares[:, None, None] * measures
    whole = np.sum(beam, axis=0, where=measures) / np.maximum(share.sum(axis=0), 1e-30)
    return np.divide(share * whole, beam, out=np.zeros_like(beam), where=measures)


def _middle(count: int, factor: int) -> slice:
    """The middle of an axis whose length is a multiple of a factor."""
    first = count % factor // 2
    return slice(first, first + count // factor * factor)
