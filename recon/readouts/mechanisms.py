"""Coefficients of any basis as photoelectric absorption, Compton scattering and K edges."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from spectra.basis.basis import Basis, BasisFunction
from spectra.materials.material import Material

MECHANISMS = Basis((BasisFunction("photoelectric"), BasisFunction("compton")))


@dataclass(frozen=True, eq=False)
class Mechanisms:
    """Conversion of coefficients in any basis to photoelectric, Compton and K-edge coefficients.

    Parameters
    ----------
    matrix : photoelectric and Compton coefficient of each function without K edge
    plain, edges : indices of the functions without and with a K edge
    water : photoelectric and Compton coefficient of water [1/mm]
    """

    matrix: Float[np.ndarray, "2 plain"]
    plain: tuple[int, ...]
    edges: tuple[int, ...]
    water: Float[np.ndarray, "2"]

    @classmethod
    def of(cls, basis: Basis, energy: Float[np.ndarray, " node"], weights: Float[np.ndarray, " node"]) -> "Mechanisms":
        """Create the conversion for a basis, by least squares over the detected spectrum.

        Parameters
        ----------
        basis : basis functions
        energy : energies of the spectrum [keV]
        weights : detected photons

        Returns
        -------
        conversion, exact where the basis has both functions itself
        """
        edges = tuple(i for i, f in enumerate(basis.functions) if f.edge_energy is not None)
        plain = tuple(i for i in range(len(basis)) if i not in edges)
        goal, values = MECHANISMS.evaluate(energy), basis.evaluate(energy)[list(plain)]
        root = np.sqrt(weights / weights.sum())
        matrix = np.linalg.lstsq((goal * root).T, (values * root).T, rcond=None)[0]
        water = Material("water", composition="Water, Liquid").coefficients_in(MECHANISMS, energy, weights)
        return cls(np.where(np.abs(matrix) < 1e-9, 0.0, matrix), plain, edges, water)

    def __call__(self, values: Float[np.ndarray, "basis ..."]) -> Float[np.ndarray, "mechanism ..."]:
        """Convert coefficients: photoelectric, Compton, then each K edge [1/mm]."""
        parts = np.tensordot(self.matrix, values[list(self.plain)], axes=1)
        return np.concatenate([parts, values[list(self.edges)]])
