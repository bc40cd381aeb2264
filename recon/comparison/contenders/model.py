"""Results of a contender: a model to score, and the models that it kept between its steps."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.reader import Dataset
from recon.comparison.contenders.channel_voxels import ChannelVoxels
from recon.comparison.contenders.recorder import Recorder
from recon.evaluation.metrics import HeldOutView
from recon.gaussians.model import GaussianModel
from recon.runs.outcomes.view_outcome import predicted_views
from recon.voxel.model import Voxels


@dataclass(frozen=True, eq=False)
class StoredViews:
    """Prediction of the test views by a method without volumes.

    Parameters
    ----------
    images : log projections [no unit]
    """

    images: Float[np.ndarray, "channel view row column"]

    def held_out_views(self, dataset: Dataset) -> Iterator[HeldOutView]:
        """Yield the test views of a dataset beside their prediction.

        Parameters
        ----------
        dataset : open dataset

        Yields
        ------
        measured and predicted counts of a view
        """
        each = iter(np.moveaxis(self.images, 1, 0))
        yield from predicted_views(dataset, lambda _: next(each)[:, None])


@dataclass(frozen=True, eq=False)
class Model:
    """Result of a method: volumes, or predictions of views.

    Parameters
    ----------
    bases : volumes of basis functions
    channels : volumes of the channels, of a method that reconstructs these; they then predict views and attenuation
    views : test views, of a method without volumes
    """

    bases: GaussianModel | Voxels | None
    channels: ChannelVoxels | None = None
    views: StoredViews | None = None

    @property
    def primitives(self) -> tuple[int, str]:
        """Number of Gaussians or of voxels, and which of both."""
        if isinstance(self.bases, GaussianModel):
            return len(self.bases), "Gaussians"
        voxels = self.channels or self.bases
        return (0 if voxels is None else voxels.values[0].size), "voxels"


@dataclass(frozen=True, eq=False)
class Runs:
    """All runs of a contender.

    Parameters
    ----------
    recorders : one per run; each serves its own budgets
    load : reads a model that a recorder has kept
    lacking : reason for a message where there is no result within a budget
    """

    recorders: tuple[Recorder, ...]
    load: Callable[[Path], Model]
    lacking: str = "no iteration ended"

    def recorder(self, budget: float) -> Recorder | None:
        """Return the recorder of the run for a budget.

        Parameters
        ----------
        budget : [s]

        Returns
        -------
        the recorder; None where no run was started for it
        """
        return next((r for r in self.recorders if budget in r.budgets), None)
