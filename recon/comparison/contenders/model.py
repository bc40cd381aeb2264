"""What a contender made: a model to score, and where the models along its way are."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.reader import Dataset
from recon.comparison.contenders.channel_voxels import ChannelVoxels
from recon.comparison.contenders.recorder import Recorder
from recon.evaluation.metrics import HeldOutView
from recon.gaussians.model import Gaussians
from recon.runs.run_views import predicted_views
from recon.voxel.model import Voxels


@dataclass(frozen=True, eq=False)
class StoredViews:
    """What a method without volumes expects in the test views.

    Parameters
    ----------
    images : log projections [no unit]
    """

    images: Float[np.ndarray, "channel view row column"]

    def held_out_views(self, dataset: Dataset) -> Iterator[HeldOutView]:
        """Test views of a dataset and what is expected there."""
        each = iter(np.moveaxis(self.images, 1, 0))
        yield from predicted_views(dataset, lambda _: next(each)[:, None])


@dataclass(frozen=True, eq=False)
class Model:
    """A reconstruction, as far as a method gives one.

    Parameters
    ----------
    bases : volumes of basis functions
    channels : volumes of the channels, where a method has them of its own; they then predict views and energies
    views : test views, where a method has nothing else
    """

    bases: Gaussians | Voxels | None
    channels: ChannelVoxels | None = None
    views: StoredViews | None = None

    @property
    def primitives(self) -> tuple[int, str]:
        """How many it consists of, and what they are."""
        if isinstance(self.bases, Gaussians):
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
    lacking : why a budget holds no result
    """

    recorders: tuple[Recorder, ...]
    load: Callable[[Path], Model]
    lacking: str = "no iteration ended"

    def recorder(self, budget: float) -> Recorder | None:
        """That of the run which serves a budget."""
        return next((r for r in self.recorders if budget in r.budgets), None)
