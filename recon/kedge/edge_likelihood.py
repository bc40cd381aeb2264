"""Likelihood of the counts of some rays as a function of the basis.

Every ray has line integrals of its own, which are fitted anew for every basis that is tried. They may be negative: held
at 0, rays with little of an element would move the energy of its edge, since noise then has a mean that depends on it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float

from phantomgen.dataset.spectral_model import Spectra, in_basis
from recon.data.measurements import in_quanta
from recon.data.readout_noise import with_floor
from recon.kedge.rays import Rays
from recon.ops.decompose import decompose
from recon.ops.deviance import deviance
from spectra.basis.basis import Basis, BasisFunction
from spectra.cramer_rao import least_covariance
from spectra.elements.attenuation import atomic_number, symbol
from spectra.transmission import Transmission

# iterations of a decomposition; nearly dependent bases would take many more without a change of the deviance; chosen by
# hand, not measured
ITERATIONS = 12
DIFFERENCE = 0.05  # keV; step of the numerical derivative in the energy of an edge; chosen by hand, not measured

Functions = tuple[BasisFunction, ...]
PerRay = Float[np.ndarray, " ray"]


@dataclass(frozen=True, eq=False)
class EdgeLikelihood:
    """Deviance of rays as a function of the basis.

    Parameters
    ----------
    rays : the rays
    spectra : spectral model of the scan; its own basis is not used
    floor : variance of readout noise in each channel [quanta^2]
    dispersion : relative model error [no unit]; the variance of counts Y is Y + (dispersion Y)^2
    """

    rays: Rays
    spectra: Spectra
    floor: Float[np.ndarray, " channel"]
    dispersion: float

    def transmission(self, functions: Functions) -> Transmission:
        """Make the model from line integrals of basis functions to expected counts.

        Parameters
        ----------
        functions : the basis

        Returns
        -------
        the spectral model
        """
        spectra = in_basis(self.spectra, Basis(functions, self.spectra.basis.reference_energy))
        found = in_quanta(spectra.transmission(), spectra.quantum)
        return with_floor(found, self.floor) if self.floor.any() else found

    def with_rays(self, rays: Rays) -> "EdgeLikelihood":
        """Make the likelihood of other rays.

        Parameters
        ----------
        rays : the rays

        Returns
        -------
        the likelihood with the same spectral model
        """
        return replace(self, rays=rays)

    def deviances(self, functions: Functions) -> tuple[PerRay, Float[np.ndarray, "ray basis"]]:
        """Fit the line integrals of every ray.

        Parameters
        ----------
        functions : the basis

        Returns
        -------
        deviance of every ray from its best line integrals [no unit], and these line integrals [no unit]
        """
        rays, transmission = self.rays, self.transmission(functions)
        lengths, _ = self._decomposed(transmission)
        whole = lengths if rays.known is None else np.hstack([lengths, rays.known])
        expected = transmission.expected(whole) * rays.gains
        each = deviance(torch.from_numpy(rays.counts), torch.from_numpy(expected), self.dispersion).numpy()
        return np.where(rays.gains > 0, each, 0.0).sum(axis=1), lengths

    def saving(self, functions: Functions) -> Callable[[BasisFunction], tuple[PerRay, PerRay]]:
        """Prepare the drop in deviance that a further function gives.

        Parameters
        ----------
        functions : the basis without the further function

        Returns
        -------
        a function from the further function to the drop in deviance on each ray, and its line integrals
        """
        before = self.deviances(functions)[0]

        def saved(further: BasisFunction) -> tuple[PerRay, PerRay]:
            after, lengths = self.deviances((*functions, further))
            return before - after, lengths[:, -1]

        return saved

    def last_length(self, functions: Functions) -> tuple[PerRay, PerRay]:
        """Fit the line integral of the last function.

        Parameters
        ----------
        functions : the basis

        Returns
        -------
        line integral of the last function on every ray [no unit], and its Fisher information, all others unknown
        """
        lengths, fisher = self._decomposed(self.transmission(functions))
        return lengths[:, -1], 1 / least_covariance(fisher)[:, -1, -1]

    def edge_information(self, functions: Functions) -> Float[np.ndarray, "edge edge"]:
        """Compute the Fisher information of the energies of all K edges among the functions.

        With G = dY/dE_K and J = dY/dL of a ray, the information is sum_r G^T V^-1 G - G^T V^-1 J F^-1 J^T V^-1 G with
        V = Y + (dispersion Y)^2 and F = J^T V^-1 J: line integrals are nuisance parameters (Schur complement).

        Parameters
        ----------
        functions : the basis

        Returns
        -------
        Fisher information [1/keV^2]
        """
        lengths = self.deviances(functions)[1]
        lengths = lengths if self.rays.known is None else np.hstack([lengths, self.rays.known])
        expected, jacobian = self.transmission(functions).expected_and_jacobian(lengths)
        gains = self.rays.gains
        expected, jacobian = expected * gains, jacobian[..., : len(functions)] * gains[..., None]
        variance = expected * (1 + self.dispersion**2 * expected)
        precision = np.divide(1.0, variance, out=np.zeros_like(variance), where=variance > 0)
        ray_gradients = [
            self._slope(functions, i, lengths) for i, f in enumerate(functions) if f.edge_energy is not None
        ]
        slopes = np.stack(ray_gradients, axis=-1)
        own = np.einsum("rc,rce,rcf->ref", precision, slopes, slopes)
        cross = np.einsum("rc,rcm,rce->rme", precision, jacobian, slopes)
        fisher = np.einsum("rc,rcm,rcn->rmn", precision, jacobian, jacobian)
        fisher += 1e-9 * np.trace(fisher, axis1=1, axis2=2)[:, None, None] * np.eye(len(functions))
        lost = np.einsum("rme,rmf->ref", cross, np.linalg.solve(fisher, cross))
        return (own - lost).sum(axis=0)

    def edge_bound(self, functions: Functions) -> float:
        """Compute the Cramer-Rao bound of the edge of the last function.

        The neighbours in the periodic table are the derivative of an element.

        Parameters
        ----------
        functions : the basis

        Returns
        -------
        least standard deviation of the energy [keV], infinite without rays
        """
        if not len(self.rays):
            return np.inf
        return float(np.sqrt(least_covariance(self.edge_information(functions))[-1, -1]))

    def _decomposed(
        self, transmission: Transmission
    ) -> tuple[Float[np.ndarray, "ray basis"], Float[np.ndarray, "ray basis basis"]]:
        """Best line integrals of every ray, and their Fisher information."""
        rays = self.rays
        return decompose(rays.counts, rays.gains, transmission, self.dispersion, ITERATIONS, known=rays.known)

    def _slope(
        self, functions: Functions, index: int, lengths: Float[np.ndarray, "ray basis"]
    ) -> Float[np.ndarray, "ray channel"]:
        """Numerical derivative of expected counts in the energy of one edge [counts/keV]."""
        sides = _beside(functions[index])
        counts = []
        for side in sides:
            moved = (*functions[:index], replace(side, name="moved"), *functions[index + 1 :])
            counts.append(self.transmission(moved).expected(lengths) * self.rays.gains)
        return (counts[1] - counts[0]) / (float(sides[1].edge_energy or 0.0) - float(sides[0].edge_energy or 0.0))


def moved_edge(edge_shape: BasisFunction, energy: float) -> BasisFunction:
    """Move a K edge to another energy.

    Parameters
    ----------
    edge_shape : a step or sigmoid, whose kind and width stay
    energy : the new energy [keV]

    Returns
    -------
    the moved function, without a name of its own
    """
    return replace(edge_shape, edge_energy=float(energy), element=None, name="")


def _beside(function: BasisFunction) -> tuple[BasisFunction, BasisFunction]:
    """Functions whose edges lie just below and above; for an element its neighbours in the periodic table."""
    if function.kind == "element":
        number = atomic_number(str(function.element))
        low, high = (BasisFunction("element", element=symbol(number + shift)) for shift in (-1, 1))
        return low, high
    edge = float(function.edge_energy or 0.0)
    return moved_edge(function, edge - DIFFERENCE), moved_edge(function, edge + DIFFERENCE)
