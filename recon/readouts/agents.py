"""Contrast agents of a basis: what a concentration adds to the coefficients, and the concentration of coefficients."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from spectra.basis.basis import Basis, BasisFunction
from spectra.elements.attenuation import atomic_number
from spectra.elements.element_sums import curve
from spectra.materials.material import Material

HEAVIEST_TISSUE = 40  # atomic number; heavier elements in the function of a material are contrast agents
_MILLIGRAM = 1e-3  # g/cm^3; 1 mg/ml
_PER_GRAM = 1e4  # mg/ml for 1/mm over cm^2/g


@dataclass(frozen=True, eq=False)
class Agent:
    """One element that basis functions show.

    Parameters
    ----------
    added : coefficients of 1 mg/ml of the element [1/mm]
    amounts : concentration that a unit of each coefficient stands for [mg/ml x mm]
    """

    added: Float[np.ndarray, " basis"]
    amounts: Float[np.ndarray, " basis"]


def agents_of(
    basis: Basis, energy: Float[np.ndarray, " node"], weights: Float[np.ndarray, " node"]
) -> dict[str, Agent]:
    """Find the contrast agents of a basis.

    An agent is the element of a function with a K edge, or an element heavier than zirconium in the function of a
    material. A coefficient alpha of the function of a material is a density of rho = alpha / (mu/rho)(E_ref), of which
    the element has its mass fraction. The coefficient of a step or sigmoid at the K edge is compared with that of
    1 mg/ml of the element in the same basis.

    Parameters
    ----------
    basis : basis functions
    energy, weights : detected spectrum, energies [keV] and photons

    Returns
    -------
    agents by the symbol of their element
    """
    shares = [_shares(function, basis.reference_energy) for function in basis.functions]
    found = {}
    for element in dict.fromkeys(name for share in shares for name in share):
        solute = Material(element, _MILLIGRAM, {element: 1.0})
        mixed = any(f.amounts and element in share for f, share in zip(basis.functions, shares, strict=True))
        added = _signed(solute, basis, energy, weights) if mixed else solute.coefficients_in(basis, energy, weights)
        amounts = np.array([share.get(element, 0.0) for share in shares])
        single = np.isnan(amounts)
        amounts[single] = 1.0 / added[single]
        found[element] = Agent(added, amounts)
    return found


def _shares(function: BasisFunction, reference: float) -> dict[str, float]:
    """Concentrations [mg/ml] of the agents per unit of the coefficient [1/mm]; NaN for functions with a K edge."""
    if function.element is not None:
        return {function.element: np.nan}
    scale = curve(function.amounts, np.array([reference]))[0] if function.kind == "material" else 1.0
    heavy = {name: amount for name, amount in function.amounts if atomic_number(name) > HEAVIEST_TISSUE}
    return {name: _PER_GRAM * amount / scale for name, amount in heavy.items()}


def _signed(
    material: Material, basis: Basis, energy: Float[np.ndarray, " node"], weights: Float[np.ndarray, " node"]
) -> Float[np.ndarray, " basis"]:
    """Coefficients of either sign with the least relative error: iodine alone is iodinated blood less blood."""
    exact = material.attenuation(energy)
    scale = np.sqrt(np.asarray(weights, dtype=np.float64) / np.sum(weights)) / exact
    return np.linalg.lstsq((basis.evaluate(energy) * scale).T, exact * scale, rcond=None)[0]
