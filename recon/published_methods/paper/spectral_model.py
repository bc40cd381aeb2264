"""The polychromatic model of the paper: 64 midpoints between 20 and 140 keV, log projections per channel (eq. 3, 4)."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from phantomgen.dataset.spectral_model import Spectra
from recon.published_methods.paper.learned_edge import ConditionedBasis
from spectra.errors import InputError

LEAST = 1e-30  # part of the open beam; least transmission of which a logarithm is taken, above float32's least


@dataclass(frozen=True, eq=False)
class EnergyGrid:
    """Energies, and the counts of each channel at these energies in the open beam.

    Parameters
    ----------
    energy : energies E_k [keV]
    weights : I_0(E_k) S_c(E_k) w_k [counts]
    profile : attenuation of the materials of a bowtie filter at the energies [1/mm]; no rows where there is none
    """

    energy: Float[np.ndarray, " energy"]
    weights: Float[np.ndarray, "channel energy"]
    profile: Float[np.ndarray, "part energy"]

    @property
    def signal(self) -> Float[np.ndarray, " energy"]:
        """Detected photons of all channels at each energy."""
        return self.weights.sum(axis=0)

    def monochromatic(self) -> "EnergyGrid":
        """Replace the energies by one per channel, the mean energy of its counts in the open beam.

        Returns
        -------
        grid of as many energies as there are channels
        """
        total = self.weights.sum(axis=1)
        energy = self.weights @ self.energy / total
        return EnergyGrid(energy, np.diag(total), _at(energy, self.energy, self.profile))


def energy_grid(spectra: Spectra, lowest: float, highest: float, count: int) -> EnergyGrid:
    """Resample the spectra of a dataset to equal intervals of energy.

    Parameters
    ----------
    spectra : spectra of the dataset
    lowest, highest : limits of the grid [keV]
    count : number of intervals

    Returns
    -------
    midpoints of the intervals; photons of a bin are shared between the intervals that it overlaps

    Raises
    ------
    InputError
        When a channel counts nothing between the two energies.
    """
    edges = np.linspace(lowest, highest, count + 1)
    middle = (edges[:-1] + edges[1:]) / 2
    left, right = spectra.edges[:-1, None], spectra.edges[1:, None]
    overlap = np.maximum(np.minimum(right, edges[1:]) - np.maximum(left, edges[:-1]), 0)
    weights = spectra.weights @ (overlap / (right - left))
    blind = np.flatnonzero(weights.sum(axis=1) <= 0)
    if len(blind):
        name = spectra.channels[blind[0]]
        raise InputError(f"channel {name} counts nothing between {lowest:g} and {highest:g} keV, the paper's energies")
    parts = np.zeros((0, len(spectra.energy))) if spectra.profile is None else spectra.profile.attenuation
    return EnergyGrid(middle, weights, _at(middle, spectra.energy, parts))


def _at(
    wanted: Float[np.ndarray, " wanted"], energy: Float[np.ndarray, " energy"], rows: Float[np.ndarray, "row energy"]
) -> Float[np.ndarray, "row wanted"]:
    """Rows of values at other energies [keV], by linear interpolation."""
    return np.array([np.interp(wanted, energy, row) for row in rows]).reshape(len(rows), len(wanted))


class SpectralModel:
    """Model of log projections of the channels from line integrals of the bases.

    Parameters
    ----------
    grid : energies and weights of the channels
    basis : columns of the fit
    profile : path lengths in the materials of a bowtie filter [mm]; None where there is none
    """

    def __init__(
        self,
        grid: EnergyGrid,
        basis: ConditionedBasis,
        profile: Float[np.ndarray, "part row column"] | None = None,
    ) -> None:
        self.grid, self.basis = grid, basis
        self.weights = torch.from_numpy(grid.weights / grid.weights.sum(axis=1, keepdims=True)).float()
        self.bowtie = None
        if profile is not None:
            self.bowtie = torch.exp(-torch.from_numpy(np.einsum("prc,pk->rck", profile, grid.profile))).float()

    def log_projections(
        self, line_integrals: Float[Tensor, "view basis row column"]
    ) -> Float[Tensor, "view channel row column"]:
        """Compute -log(I_c / I_0c) of each channel (eq. 3 and 4).

        Parameters
        ----------
        line_integrals : line integrals of the bases [no unit]

        Returns
        -------
        log projections, differentiable in the line integrals and in the K edge
        """
        columns = self.basis.columns(self.grid.energy).to(line_integrals)
        beam = torch.exp(-line_integrals.movedim(1, -1) @ columns)
        part = beam @ self.weights.T
        if self.bowtie is not None:
            part = (beam * self.bowtie) @ self.weights.T / (self.bowtie @ self.weights.T).clamp_min(LEAST)
        return -torch.log(part.clamp_min(LEAST)).movedim(-1, 1)

    def channel_means(self) -> Float[Tensor, "channel basis"]:
        """Average the columns over the counts of each channel in the open beam.

        Returns
        -------
        mean of each basis function in each channel
        """
        return self.weights @ self.basis.columns(self.grid.energy).T.float()
