"""Sensitivities of the channels as tensors, which an optimizer may change."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from phantomgen.dataset.spectral_model import Spectra
from spectra.errors import InputError
from spectra.transmission import Transmission


@dataclass(frozen=True, eq=False)
class TensorSpectra:
    """Spectral model as tensors, in float64; either may carry a gradient.

    Parameters
    ----------
    weights : sensitivity of each channel at each energy, photons x response [counts]: what an open beam gives
    columns : functions of energy whose line integrals are known: the basis functions, and after them the absorbers of a
        beam profile where the dataset has one

    Raises
    ------
    InputError
        When the tensors have different numbers of energies.
    """

    weights: Float[Tensor, "channel energy"]
    columns: Float[Tensor, "column energy"]

    def __post_init__(self) -> None:
        if self.weights.ndim != 2 or self.columns.ndim != 2 or self.weights.shape[1] != self.columns.shape[1]:
            shapes = f"{tuple(self.weights.shape)} and {tuple(self.columns.shape)}"
            raise InputError(f"weights (channel, energy) and columns (column, energy) do not fit: got {shapes}")

    @classmethod
    def of(
        cls, spectra: "Spectra | Transmission | TensorSpectra", device: torch.device | str = "cpu"
    ) -> "TensorSpectra":
        """Create tensors from a spectral model.

        Parameters
        ----------
        spectra : of a dataset (``dataset.spectra``), or a transmission, whose nodes then are the energies; tensors are
            returned as they are
        device : of the new tensors

        Returns
        -------
        the spectral model without gradients
        """
        if isinstance(spectra, TensorSpectra):
            return spectra
        if isinstance(spectra, Transmission):
            weights = np.zeros((len(spectra), len(spectra.weights)))
            for row, begin, end in zip(weights, spectra.starts[:-1], spectra.starts[1:], strict=True):
                row[begin:end] = spectra.weights[begin:end]
            return cls(torch.tensor(weights, device=device), torch.tensor(spectra.columns, device=device))
        parts = [] if spectra.profile is None else [spectra.profile.attenuation]
        columns = np.concatenate([spectra.basis_values, *parts])
        return cls(torch.tensor(spectra.weights, device=device), torch.tensor(columns, device=device))

    def __repr__(self) -> str:
        (channels, energies), columns = self.weights.shape, len(self.columns)
        return f"TensorSpectra({channels} channels, {columns} columns, {energies} energies)"
