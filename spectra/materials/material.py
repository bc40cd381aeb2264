"""Materials: a composition with a density, or explicit coefficients in a basis."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import nnls

from spectra.basis.basis import Basis
from spectra.elements.attenuation import (
    Composition,
    k_edges,
    linear_attenuation,
    mass_fractions,
    natural_density,
    symbol,
)
from spectra.errors import InputError

# An element belongs to a K-edge function when its own edge is this close [keV].
SAME_EDGE = 0.5

EnergyArray = Float[np.ndarray, " energy"]


@dataclass(frozen=True)
class Material:
    """Material of an object: a composition with a density, or explicit basis coefficients.

    Parameters
    ----------
    name : as in the scene
    density : [g/cm^3]; may be left out for elements and named materials
    composition : formula, name (NIST compound or `spectra.elements.named_materials`) or mass fractions, for the
        exact xraylib curve
    coefficients : or basis coefficients by basis function name [1/mm]; functions left out are 0
    """

    name: str
    density: float | None = None
    composition: Composition | None = None
    coefficients: Mapping[str, float] | None = None

    def __post_init__(self) -> None:
        if (self.composition is None) == (self.coefficients is None):
            raise InputError(f"material {self.name!r} needs either a composition or coefficients")
        if self.composition is not None:
            object.__setattr__(self, "density", self._checked_density(self.composition))
        elif self.coefficients is not None and not all(0 <= v < np.inf for v in self.coefficients.values()):
            raise InputError(f"coefficients of material {self.name!r} must be finite and not negative [1/mm]")

    def _checked_density(self, composition: Composition) -> float:
        """The density given, or the one known."""
        known = natural_density(composition)
        density = self.density if self.density is not None else known
        if density is None:
            raise InputError(f"material {self.name!r} needs a density in g/cm^3")
        if not 0 < density < 30:
            raise InputError(f"the density of material {self.name!r} must be within 0 .. 30 g/cm^3, got {density:g}")
        return float(density)

    def k_edges(self, low: float, high: float) -> tuple[float, ...]:
        """Return the K edges of a composition between two energies; none for explicit coefficients.

        Parameters
        ----------
        low, high : limits [keV]

        Returns
        -------
        energies, ascending [keV]
        """
        return () if self.composition is None else k_edges(self.composition, low, high)

    def attenuation(self, energy: EnergyArray, basis: Basis | None = None) -> EnergyArray:
        """Compute the linear attenuation coefficient: the exact curve, or coefficients times `basis`.

        Parameters
        ----------
        energy : photon energies [keV]
        basis : basis of explicit coefficients; not used for a composition

        Returns
        -------
        mu [1/mm]

        Raises
        ------
        InputError
            When a material with explicit coefficients has no basis.
        """
        if self.composition is not None and self.density is not None:
            return linear_attenuation(self.composition, self.density, energy)
        if basis is None:
            raise InputError(f"material {self.name!r} is given by coefficients: its attenuation needs a basis")
        return self._explicit(basis) @ basis.evaluate(energy)

    def coefficients_in(self, basis: Basis, energy: EnergyArray, weights: EnergyArray) -> Float[np.ndarray, " basis"]:
        """Compute the coefficients of the material in `basis` [1/mm].

        Parameters
        ----------
        basis : raw basis functions
        energy, weights : detected spectrum, energies [keV] and photons

        Returns
        -------
        the explicit coefficients. For a composition those of `element` functions are the amount of the element, and
        those of `step` and `sigmoid` functions are 0 where no K edge of the material is near; what is left of mu(E) is
        fitted by the other functions, non-negative unless the basis is signed, with the least relative error over the
        detected spectrum (plain least squares would fit the lowest energies only)
        """
        if self.composition is None:
            return self._explicit(basis)
        exact, values = self.attenuation(energy), basis.evaluate(energy)
        found = self._amounts(basis, energy)
        free = np.isnan(found)
        rest = exact - np.where(free, 0.0, found) @ values
        scale = np.sqrt(np.asarray(weights, dtype=np.float64) / np.sum(weights)) / exact
        if free.any():
            solve = np.linalg.lstsq if basis.signed else nnls
            found[free] = solve((values[free] * scale).T, rest * scale)[0]
        return found

    def fit_error(self, basis: Basis, energy: EnergyArray, weights: EnergyArray) -> float:
        """Compute the weighted rms relative error of mu(E) as `coefficients_in` describes it.

        Parameters
        ----------
        basis : raw basis functions
        energy, weights : detected spectrum, energies [keV] and photons

        Returns
        -------
        relative error; 0 for explicit coefficients
        """
        if self.composition is None:
            return 0.0
        fitted = self.coefficients_in(basis, energy, weights) @ basis.evaluate(energy)
        return float(np.sqrt(np.average((fitted / self.attenuation(energy) - 1) ** 2, weights=weights)))

    def _amounts(self, basis: Basis, energy: EnergyArray) -> Float[np.ndarray, " basis"]:
        """Coefficients that follow from the composition [1/mm]; NaN for those that are to be fitted."""
        fractions = {symbol(number): share for number, share in mass_fractions(self.composition or {})}
        amounts = np.full(len(basis), np.nan)
        for i, function in enumerate(basis.functions):
            edge = function.edge_energy
            if function.kind == "element":
                density = float(self.density or 0.0) * fractions.get(str(function.element), 0.0)
                own = linear_attenuation({str(function.element): 1.0}, density, energy[:1])
                amounts[i] = (own / function.evaluate(energy[:1], basis.reference_energy))[0]
            elif edge is not None and not self.k_edges(edge - SAME_EDGE, edge + SAME_EDGE):
                amounts[i] = 0.0
        return amounts

    def _explicit(self, basis: Basis) -> Float[np.ndarray, " basis"]:
        """Explicit coefficients in the order of `basis`."""
        coefficients = dict(self.coefficients or {})
        unknown = sorted(set(coefficients) - set(basis.names))
        if unknown:
            raise InputError(
                f"material {self.name!r} has a coefficient for {unknown[0]!r}, which is not in the basis "
                f"({', '.join(basis.names)})"
            )
        return np.array([float(coefficients.get(name, 0.0)) for name in basis.names])
