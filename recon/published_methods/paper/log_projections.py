"""Log projections, as the paper's loss wants them."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from phantomgen.geometry.poses import Geometry
from recon.data.measurements import Measurements
from recon.data.readout_noise import without_floor

LEAST = 0.5  # counts; a pixel that counted nothing is taken to have counted this much


@dataclass(frozen=True, eq=False)
class Projections:
    """Counts of some views, and what the same pixels count without an object.

    Parameters
    ----------
    counts : measured counts
    open_beam : from flat-field frames, with each view's exposure; 0 where nothing was measured
    geometry : poses of the views
    """

    counts: Float[np.ndarray, "view channel row column"]
    open_beam: Float[np.ndarray, "view channel row column"]
    geometry: Geometry

    @classmethod
    def of(cls, measured: Measurements) -> "Projections":
        """From measurements; what noise of the electronics adds to counts is taken out again."""
        bare, floor = without_floor(measured.transmission)
        if floor.any():
            measured = measured.shifted(-floor, bare)
        air = measured.gains * measured.open_beam * measured.exposure[:, :, None, None]
        return cls(measured.counts, air.astype(np.float32), measured.geometry)

    def __len__(self) -> int:
        return len(self.counts)

    def log(self, views: slice) -> Float[Tensor, "view channel row column"]:
        """-log(I / I_0); 0 where nothing was measured."""
        air = torch.from_numpy(self.open_beam[views])
        counts = torch.from_numpy(self.counts[views]).clamp_min(LEAST)
        return torch.where(air > 0, torch.log(air.clamp_min(LEAST) / counts), 0.0)
