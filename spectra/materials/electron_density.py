"""Electrons in matter: what scatters X-rays."""

import numpy as np
from jaxtyping import Float

from spectra.basis.basis import Basis, BasisFunction, klein_nishina
from spectra.elements.attenuation import Composition, electrons_per_gram, mass_attenuation
from spectra.errors import InputError
from spectra.materials.material import Material

# Classical electron radius [mm], CODATA 2018.
ELECTRON_RADIUS = 2.8179403262e-12


def electron_density(material: Material, basis: Basis) -> float:
    """Compute the number of electrons per volume.

    For a composition it follows from the elements. For explicit coefficients, `compton` is the Klein-Nishina cross
    section of all electrons; coefficients of elements and materials give their amount; `photoelectric`, `step` and
    `sigmoid` mean absorption alone.

    Parameters
    ----------
    material : by composition or by coefficients
    basis : that coefficients belong to

    Returns
    -------
    electrons [1/mm^3]

    Raises
    ------
    InputError
        When a coefficient belongs to a function that gives no number of electrons.
    """
    if material.composition is not None:
        return float(material.density or 0.0) / 1000 * electrons_per_gram(material.composition)
    given = dict(material.coefficients or {})
    return sum(_electrons(f, basis.reference_energy, given[f.name]) for f in basis.functions if given.get(f.name))


def electrons_per_coefficient(basis: Basis) -> Float[np.ndarray, " basis"]:
    """Compute the number of electrons per volume that a coefficient of 1 per mm of each basis function stands for.

    Parameters
    ----------
    basis : basis functions

    Returns
    -------
    electrons [1/mm^3 per 1/mm], see `electron_density`

    Raises
    ------
    InputError
        When a function gives no number of electrons.
    """
    return np.array([_electrons(function, basis.reference_energy, 1.0) for function in basis.functions])


def _electrons(function: BasisFunction, reference: float, coefficient: float) -> float:
    """Electrons per volume [1/mm^3] of a coefficient [1/mm]."""
    if function.kind == "compton":
        return coefficient / (2 * np.pi * ELECTRON_RADIUS**2 * klein_nishina(np.array([reference]))[0])
    if function.kind == "svd":
        raise InputError(f"coefficients of the function {function.name!r} do not tell how many electrons there are")
    if function.kind == "element":
        at = np.array([function.normalisation_energy(reference) + 0.01])
        return _of_matter({str(function.element): 1.0}, coefficient, at)
    return _of_matter(dict(function.amounts), coefficient, np.array([reference])) if function.amounts else 0.0


def _of_matter(composition: Composition, attenuation: float, energy: np.ndarray) -> float:
    """Electrons per volume [1/mm^3] of matter with some attenuation [1/mm] at `energy` [keV]."""
    density = 10 * attenuation / mass_attenuation(composition, energy)[0]
    return density / 1000 * electrons_per_gram(composition)
