"""What a contender made: a model to score, and where the models along its way are."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from recon.comparison.channel_voxels import ChannelVoxels
from recon.comparison.recorder import Recorder
from recon.gaussians import Gaussians
from recon.voxels import Voxels


@dataclass(frozen=True, eq=False)
class Model:
    """A reconstruction, as far as a method gives one.

    Parameters
    ----------
    bases : volumes of basis functions
    channels : volumes of the channels, where a method has them of its own; they then predict views and energies
    """

    bases: Gaussians | Voxels | None
    channels: ChannelVoxels | None = None

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
