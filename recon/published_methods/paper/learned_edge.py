"""Basis functions of the paper: photoelectric, Compton, and a K edge that is learned and conditioned.

The K-edge column is alpha_K s(gamma_K (E - E_K)). Photoelectric and Compton are 1 at E_ref = 70 keV; the logistic
function is 1 above its edge, and is left so: to divide it by its value at 70 keV, as the paper's words may be read,
cancels alpha_K and has a pole once the column is orthogonal to the others.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from spectra.basis.basis import BasisFunction

FIXED = ("photoelectric", "compton")


@dataclass
class KEdge:
    """Learnable parameters of the third column.

    Parameters
    ----------
    energy : E_K [keV]
    log_slope : logarithm of gamma_K [log 1/keV]
    log_amplitude : logarithm of alpha_K
    """

    energy: Float[Tensor, ""]
    log_slope: Float[Tensor, ""]
    log_amplitude: Float[Tensor, ""]

    @classmethod
    def at(cls, energy: float, slope: float) -> "KEdge":
        """An edge of amplitude 1."""
        return cls(*(torch.tensor(x, dtype=torch.float64) for x in (energy, float(np.log(slope)), 0.0)))

    def tensors(self) -> tuple[Tensor, Tensor, Tensor]:
        """The three parameters."""
        return self.energy, self.log_slope, self.log_amplitude

    def column(self, energy: Float[Tensor, " energy"]) -> Float[Tensor, " energy"]:
        """alpha_K s(gamma_K (E - E_K)) at `energy` [keV]."""
        return torch.exp(self.log_amplitude) * torch.sigmoid(torch.exp(self.log_slope) * (energy - self.energy))


def fixed_columns(energy: Float[np.ndarray, " energy"]) -> Float[Tensor, "2 energy"]:
    """Photoelectric and Compton columns, 1 at 70 keV."""
    return torch.from_numpy(np.stack([BasisFunction(kind).evaluate(energy) for kind in FIXED]))


class ConditionedBasis:
    """Columns of the fit: the K edge minus what photoelectric and Compton explain of it, in the norm of the signal.

    Parameters
    ----------
    energy : nodes of the fine grid [keV]
    signal : detected photons at the nodes, the diagonal weighting
    edge : the third column; None for two bases
    conditioned : whether the third column is made orthogonal to the others
    """

    def __init__(
        self,
        energy: Float[np.ndarray, " energy"],
        signal: Float[np.ndarray, " energy"],
        edge: KEdge | None,
        conditioned: bool = True,
    ) -> None:
        self.energy, self.edge, self.conditioned = torch.from_numpy(energy), edge, conditioned
        self.share = torch.from_numpy(signal / signal.sum())
        fixed = fixed_columns(energy)
        self._project = torch.linalg.solve((fixed * self.share) @ fixed.T, fixed * self.share)

    def __len__(self) -> int:
        return 2 if self.edge is None else 3

    def overlap(self) -> Float[Tensor, "2"]:
        """How much of the photoelectric and the Compton column the K edge holds; zeros where it is not conditioned."""
        if self.edge is None or not self.conditioned:
            return torch.zeros(2, dtype=torch.float64)
        return self._project @ self.edge.column(self.energy)

    def columns(self, energy: Float[np.ndarray, " energy"]) -> Float[Tensor, "basis energy"]:
        """The columns at any energies; gradients reach the K edge, also through its overlap with the others."""
        fixed = fixed_columns(energy)
        if self.edge is None:
            return fixed
        rest = self.edge.column(torch.from_numpy(energy)) - self.overlap() @ fixed
        return torch.cat([fixed, rest[None]])

    @torch.no_grad()
    def to_raw(self, raw: Float[np.ndarray, "raw energy"]) -> Float[Tensor, "basis raw"]:
        """Matrix T with coefficients_raw = coefficients T, for raw functions given at the nodes of the fine grid.

        Photoelectric and Compton keep their coefficients. With p and q the overlap, a K-edge coefficient k of the
        conditioned column is k of the learned edge, -p k of photoelectric and -q k of Compton; that edge in turn is the
        combination of raw functions nearest to it, in the norm of the signal. Exact where the raw functions span it.
        """
        root = self.share.sqrt()
        own = self.columns(self.energy.numpy())
        return torch.linalg.lstsq((torch.from_numpy(raw) * root).T, (own * root).T).solution.T
