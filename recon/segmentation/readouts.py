"""Physical numbers from coefficients: effective atomic number, electron density, concentrations, Hounsfield units.

All are linear in the coefficients except the effective atomic number. It follows from the ratio of photoelectric
absorption to Compton scattering, by comparison with the coefficients of the elements in the same basis over the same
spectrum, so that no exponent of Z is assumed and errors of the basis cancel. Contrast agents are subtracted first.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from recon.segmentation.features import MECHANISMS, Mechanisms
from spectra.basis.basis import Basis
from spectra.elements.attenuation import electrons_per_gram, symbol
from spectra.errors import InputError
from spectra.materials.material import Material

HEAVIEST = 40  # atomic number; largest that is reported, as K edges of heavier elements lie within spectra
WATER = Material("water", composition="Water, Liquid")
_MILLIGRAM = 1e-3  # g/cm^3; 1 mg/ml
_LEAST_MATTER = 0.02  # electron density of water; voxels below it get no atomic number; our choice

Volume = Float[np.ndarray, "..."]  # without axes for the coefficients of one place
Coefficients = Float[np.ndarray, "basis ..."]


@dataclass(frozen=True, eq=False)
class Readouts:
    """Conversion of coefficients to physical numbers.

    Parameters
    ----------
    basis : basis functions of the coefficients
    mechanisms : conversion to photoelectric, Compton and K-edge coefficients
    water : coefficients of water [1/mm]
    agents : by element of a K-edge function, the coefficients of 1 mg/ml of the element [1/mm]
    nameless : indices of K-edge functions without an element
    angles : arc tangent of photoelectric over Compton for each atomic number from 1 on, ascending [rad]
    per_electron : norm of the photoelectric and Compton coefficients at the electron density of water [1/mm]
    """

    basis: Basis
    mechanisms: Mechanisms
    water: Float[np.ndarray, " basis"]
    agents: dict[str, Float[np.ndarray, " basis"]]
    nameless: tuple[int, ...]
    angles: Float[np.ndarray, " element"]
    per_electron: Float[np.ndarray, " element"]

    @classmethod
    def of(cls, basis: Basis, energy: Float[np.ndarray, " node"], weights: Float[np.ndarray, " node"]) -> "Readouts":
        """Create the conversion for a basis and a detected spectrum.

        Parameters
        ----------
        basis : basis functions
        energy : energies of the spectrum [keV]
        weights : detected photons

        Returns
        -------
        conversion
        """
        spectrum = energy, weights
        mechanisms = Mechanisms.of(basis, *spectrum)
        agents, nameless = {}, []
        for index in mechanisms.edges:
            element = basis.functions[index].element
            if element is None:
                nameless.append(index)
            else:
                solute = Material(element, _MILLIGRAM, {element: 1.0})
                agents[element] = solute.coefficients_in(basis, *spectrum)
        table = _element_table(*spectrum)
        angles = np.maximum.accumulate(np.arctan2(table[:, 0], table[:, 1]))
        water = WATER.coefficients_in(basis, *spectrum)
        return cls(basis, mechanisms, water, agents, tuple(nameless), angles, np.linalg.norm(table, axis=1))

    def concentration(self, values: Coefficients, element: str) -> Volume:
        """Compute the concentration of a contrast agent.

        Parameters
        ----------
        values : coefficients [1/mm]
        element : symbol of the element of a K-edge function

        Returns
        -------
        concentration [mg/ml]
        """
        index = next(i for i, f in enumerate(self.basis.functions) if f.element == element)
        return np.asarray(values[index] / self.agents[element][index])

    def without_contrast(self, values: Coefficients) -> Coefficients:
        """Subtract contrast agents from coefficients.

        Parameters
        ----------
        values : coefficients [1/mm]

        Returns
        -------
        coefficients without all that the elements of K-edge functions add, or without the function alone where it has
        no element [1/mm]
        """
        left = np.array(values, dtype=np.float64)
        for element, added in self.agents.items():
            amount = self.concentration(values, element)
            left -= np.multiply.outer(added, amount)
        left[list(self.nameless)] = 0.0
        return left

    def attenuation(self, values: Coefficients, energy: float) -> Volume:
        """Compute the attenuation at an energy.

        Parameters
        ----------
        values : coefficients [1/mm]
        energy : energy [keV]

        Returns
        -------
        attenuation [1/mm]
        """
        return np.tensordot(self.basis.evaluate(np.array([energy], dtype=np.float64))[:, 0], values, axes=1)

    def hounsfield(self, values: Coefficients, energy: float) -> Volume:
        """Compute a virtual monoenergetic image.

        Parameters
        ----------
        values : coefficients [1/mm]
        energy : energy [keV]

        Returns
        -------
        CT number [HU]; that of water, as the basis describes it, is 0 at every energy
        """
        water = float(self.attenuation(self.water, energy))
        return np.asarray(1000.0 * (self.attenuation(values, energy) / water - 1.0))

    def electrons(self, values: Coefficients) -> tuple[Volume, Volume]:
        """Compute effective atomic number and electron density, both without contrast agents.

        Parameters
        ----------
        values : coefficients [1/mm]

        Returns
        -------
        effective atomic number, and electron density relative to water. The number is NaN below 2 % of the electron
        density of water, for a single basis function, and beyond `HEAVIEST`
        """
        photo, compton = self.mechanisms(self.without_contrast(values))[:2]
        if len(self.mechanisms.plain) < 2:
            return np.full(np.shape(photo), np.nan), np.full(np.shape(photo), np.nan)
        angle = np.arctan2(np.maximum(photo, 0.0), np.maximum(compton, 1e-12))
        numbers = np.arange(1, HEAVIEST + 1, dtype=np.float64)
        number = np.interp(angle, self.angles, numbers, right=np.nan)
        density = np.asarray(np.hypot(photo, compton) / np.interp(angle, self.angles, self.per_electron))
        return np.where(density > _LEAST_MATTER, number, np.nan), density


def check_energies(energies: Sequence[float]) -> tuple[float, ...]:
    """Check the energies of virtual monoenergetic images.

    Parameters
    ----------
    energies : energies [keV]

    Returns
    -------
    the energies

    Raises
    ------
    InputError
        When an energy is outside of 10 to 500 keV.
    """
    for energy in energies:
        if not 10 <= energy <= 500:
            raise InputError(f"--energy must be between 10 and 500 keV, got {energy:g}")
    return tuple(energies)


def _element_table(
    energy: Float[np.ndarray, " node"], weights: Float[np.ndarray, " node"]
) -> Float[np.ndarray, "element 2"]:
    """Photoelectric and Compton coefficients [1/mm] of every element at the electron density of water."""
    electrons = float(WATER.density or 0.0) * electrons_per_gram("Water, Liquid")
    rows = []
    for number in range(1, HEAVIEST + 1):
        element = {symbol(number): 1.0}
        gram = Material(symbol(number), 1.0, element).coefficients_in(MECHANISMS, energy, weights)
        rows.append(gram * electrons / electrons_per_gram(element))
    return np.array(rows)
