"""Physical numbers from coefficients: effective atomic number, electron density, concentrations, Hounsfield units.

All are linear in the coefficients except the effective atomic number. It follows from the ratio of photoelectric
absorption to Compton scattering, by comparison with the coefficients of the elements in the same basis over the same
spectrum, so that no exponent of Z is assumed and errors of the basis cancel. Contrast agents are subtracted first.

References
----------
.. [1] Alvarez & Macovski 1976, doi:10.1088/0031-9155/21/5/002: monoenergetic images from coefficients, eq. 1
.. [2] Heismann, Leppert & Stierstorfer 2003, J. Appl. Phys. 94, 2073-2079: density and atomic number from two energies
.. [3] Roessl & Proksa 2007, doi:10.1088/0031-9155/52/15/020: concentrations from K-edge functions
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from recon.readouts.agents import HEAVIEST_TISSUE, Agent, agents_of
from recon.readouts.mechanisms import MECHANISMS, Mechanisms
from spectra.basis.basis import Basis
from spectra.elements.attenuation import electrons_per_gram, symbol
from spectra.errors import InputError
from spectra.materials.material import Material

WATER = Material("water", composition="Water, Liquid")
HEAVIEST = HEAVIEST_TISSUE  # atomic number; largest that is reported, as K edges of heavier elements lie within spectra
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
    agents : contrast agents by the symbol of their element
    nameless : indices of K-edge functions without an element
    angles : arc tangent of photoelectric over Compton for each atomic number from 1 on, ascending [rad]
    per_electron : norm of the photoelectric and Compton coefficients at the electron density of water [1/mm]
    spectrum : energies of the nodes [keV], and their detected photons
    """

    basis: Basis
    mechanisms: Mechanisms
    water: Float[np.ndarray, " basis"]
    agents: dict[str, Agent]
    nameless: tuple[int, ...]
    angles: Float[np.ndarray, " element"]
    per_electron: Float[np.ndarray, " element"]
    spectrum: tuple[Float[np.ndarray, " node"], Float[np.ndarray, " node"]]

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
        nameless = tuple(i for i in mechanisms.edges if basis.functions[i].element is None)
        table = _element_table(*spectrum)
        angles = np.maximum.accumulate(np.arctan2(table[:, 0], table[:, 1]))
        water = WATER.coefficients_in(basis, *spectrum)
        norms = np.linalg.norm(table, axis=1)
        return cls(basis, mechanisms, water, agents_of(basis, *spectrum), nameless, angles, norms, spectrum)

    @property
    def span(self) -> tuple[float, float]:
        """Lowest and highest energy of the detected spectrum [keV]."""
        energy, weights = self.spectrum
        return float(energy[weights > 0].min()), float(energy[weights > 0].max())

    @property
    def tells_electrons(self) -> bool:
        """True where two functions are left without those of contrast agents, as atomic numbers require."""
        return len(self.basis) - len(self.agents) - len(self.nameless) >= 2

    def concentration(self, values: Coefficients, element: str) -> Volume:
        """Compute the concentration of a contrast agent.

        Parameters
        ----------
        values : coefficients [1/mm]
        element : symbol of the element

        Returns
        -------
        concentration [mg/ml]

        Raises
        ------
        InputError
            When no basis function shows the element.
        """
        if element not in self.agents:
            names = ", ".join(f.name for f in self.basis.functions)
            shown = f"its functions show {', '.join(self.agents)}" if self.agents else "none of its functions shows one"
            raise InputError(
                f"the basis ({names}) cannot show the concentration of {element}: {shown}; scan and fit with a basis "
                f"function of {element}"
            )
        return np.asarray(np.tensordot(self.agents[element].amounts, values, axes=1))

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
        for element, agent in self.agents.items():
            left -= np.multiply.outer(agent.added, self.concentration(values, element))
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

    def hounsfield(self, values: Coefficients, energy: float, water: float | None = None) -> Volume:
        """Compute a virtual monoenergetic image, 1000 (mu / mu_water - 1).

        Parameters
        ----------
        values : coefficients [1/mm]
        energy : energy [keV]
        water : attenuation of water at this energy [1/mm]; None for that of water as the basis describes it, so that
            water is 0 at every energy; `tabulated_water` has that of tables

        Returns
        -------
        CT number [HU]
        """
        zero = float(self.attenuation(self.water, energy)) if water is None else water
        return np.asarray(1000.0 * (self.attenuation(values, energy) / zero - 1.0))

    def virtual_non_contrast(self, values: Coefficients, energy: float, water: float | None = None) -> Volume:
        """Compute a virtual monoenergetic image without contrast agents.

        Parameters
        ----------
        values : coefficients [1/mm]
        energy : energy [keV]
        water : as in `hounsfield`

        Returns
        -------
        CT number [HU]
        """
        return self.hounsfield(self.without_contrast(values), energy, water)

    def electron_density(self, values: Coefficients) -> Volume:
        """Compute the electron density without contrast agents.

        Parameters
        ----------
        values : coefficients [1/mm]

        Returns
        -------
        electron density relative to that of water, which is 3.343e23 per cm^3
        """
        return self.electrons(values)[1]

    def effective_atomic_number(self, values: Coefficients) -> Volume:
        """Compute the effective atomic number without contrast agents.

        Parameters
        ----------
        values : coefficients [1/mm]

        Returns
        -------
        atomic number; NaN where `electrons` gives none
        """
        return self.electrons(values)[0]

    def extrapolation(self, energy: float) -> str | None:
        """Say where an energy is outside of the spectrum that the coefficients were measured with.

        Parameters
        ----------
        energy : energy of a virtual monoenergetic image [keV]

        Returns
        -------
        a sentence; None within the spectrum
        """
        low, high = self.span
        if low <= energy <= high:
            return None
        return (
            f"{energy:g} keV is outside of the detected spectrum (nodes at {low:.0f} to {high:.0f} keV): the image "
            "is an extrapolation of the basis functions, which no count has tested"
        )

    def electrons(self, values: Coefficients) -> tuple[Volume, Volume]:
        """Compute effective atomic number and electron density, both without contrast agents.

        Parameters
        ----------
        values : coefficients [1/mm]

        Returns
        -------
        effective atomic number, and electron density relative to water. The number is NaN below 2 % of the electron
        density of water, without two functions besides those of contrast agents, and beyond `HEAVIEST`
        """
        photo, compton = self.mechanisms(self.without_contrast(values))[:2]
        if not self.tells_electrons:
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


def tabulated_water(energy: float) -> float:
    """Return the attenuation of water at 1 g/cm^3 from tables.

    Parameters
    ----------
    energy : energy [keV]

    Returns
    -------
    attenuation [1/mm]
    """
    return float(WATER.attenuation(np.array([energy], dtype=np.float64))[0])


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
