"""Basis functions of the paper: photoelectric, Compton, and a K edge that is learned and conditioned.

The K-edge column is alpha_K s(gamma_K (E - E_K)), with s the logistic function. Photoelectric and Compton are 1 at
E_ref = 70 keV. The K-edge column is not divided by its value at 70 keV, as the text of the paper can be understood:
that would cancel alpha_K, and would have a pole once the column is orthogonal to the others.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from spectra.basis.basis import BasisFunction

FIXED = ("photoelectric", "compton")  # kinds of the columns that are not learned


@dataclass
class KEdge:
    """Learned parameters of the K-edge column.

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
        """Create an edge of amplitude 1.

        Parameters
        ----------
        energy : E_K [keV]
        slope : gamma_K [1/keV]

        Returns
        -------
        the edge, in float64
        """
        return cls(*(torch.tensor(x, dtype=torch.float64) for x in (energy, float(np.log(slope)), 0.0)))

    def tensors(self) -> tuple[Tensor, Tensor, Tensor]:
        """Return the three parameters.

        Returns
        -------
        energy, log slope and log amplitude, not copies
        """
        return self.energy, self.log_slope, self.log_amplitude

    def column(self, energy: Float[Tensor, " energy"]) -> Float[Tensor, " energy"]:
        """Compute alpha_K s(gamma_K (E - E_K)), the K-edge column.

        Parameters
        ----------
        energy : energies [keV]

        Returns
        -------
        values at the energies, differentiable in the three parameters
        """
        return torch.exp(self.log_amplitude) * torch.sigmoid(torch.exp(self.log_slope) * (energy - self.energy))


def fixed_columns(energy: Float[np.ndarray, " energy"]) -> Float[Tensor, "2 energy"]:
    """Compute the photoelectric and the Compton column, 1 at 70 keV.

    Parameters
    ----------
    energy : energies [keV]

    Returns
    -------
    values at the energies
    """
    return torch.from_numpy(np.stack([BasisFunction(kind).evaluate(energy) for kind in FIXED]))


class ConditionedBasis:
    """Columns of the fit: the K edge minus its projection on photoelectric and Compton, in the norm of the signal.

    Parameters
    ----------
    energy : energies of the fine grid [keV]
    signal : detected photons at these energies, which weight the norm
    edge : K-edge column; None for two bases
    conditioned : whether the K-edge column is made orthogonal to the others
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
        """Compute the coefficients of the projection of the K edge on photoelectric and Compton.

        Returns
        -------
        the two coefficients; zeros where the column is not made orthogonal
        """
        if self.edge is None or not self.conditioned:
            return torch.zeros(2, dtype=torch.float64)
        return self._project @ self.edge.column(self.energy)

    def columns(self, energy: Float[np.ndarray, " energy"]) -> Float[Tensor, "basis energy"]:
        """Compute the columns at any energies.

        Parameters
        ----------
        energy : energies [keV]

        Returns
        -------
        values of all columns, differentiable in the K edge, also through its overlap with the others
        """
        fixed = fixed_columns(energy)
        if self.edge is None:
            return fixed
        rest = self.edge.column(torch.from_numpy(energy)) - self.overlap() @ fixed
        return torch.cat([fixed, rest[None]])

    @torch.no_grad()
    def to_raw(self, raw: Float[np.ndarray, "raw energy"]) -> Float[Tensor, "basis raw"]:
        """Compute the matrix T of coefficients_raw = coefficients T.

        Parameters
        ----------
        raw : values of the raw functions at the energies of the fine grid

        Returns
        -------
        matrix T

        Notes
        -----
        Photoelectric and Compton keep their coefficients. With p and q the overlap, a K-edge coefficient k of the
        conditioned column is k of the learned edge, -p k of photoelectric and -q k of Compton. The learned edge is
        replaced by the combination of raw functions that is nearest to it in the norm of the signal. That is exact
        where the raw functions span it.
        """
        root = self.share.sqrt()
        own = self.columns(self.energy.numpy())
        return torch.linalg.lstsq((torch.from_numpy(raw) * root).T, (own * root).T).solution.T
