"""Attenuation curves as sums over elements: sum_Z a_Z (mu/rho)_Z(E).

The amounts a_Z of a material are its mass fractions; those of a difference of materials may be negative.
"""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

from spectra.elements.attenuation import Composition, k_edges, mass_attenuation, mass_fractions, symbol
from spectra.errors import InputError

Amounts = tuple[tuple[str, float], ...]
EnergyArray = Float[np.ndarray, " energy"]


def amounts_of(composition: Composition) -> Amounts:
    """Compute mass fractions by element symbol.

    Parameters
    ----------
    composition : formula, name or mass fractions

    Returns
    -------
    pairs of symbol and mass fraction
    """
    return tuple((symbol(number), share) for number, share in mass_fractions(composition))


def added(parts: Iterable[tuple[Amounts, float]]) -> Amounts:
    """Add amounts of elements, each multiplied by a factor.

    Parameters
    ----------
    parts : pairs of amounts and factor

    Returns
    -------
    sum of all parts
    """
    total: dict[str, float] = {}
    for amounts, factor in parts:
        for element, amount in amounts:
            total[element] = total.get(element, 0.0) + factor * amount
    return tuple(total.items())


def curve(amounts: Amounts, energy: EnergyArray) -> EnergyArray:
    """Compute the attenuation curve of amounts of elements: the sum of amount times mu/rho.

    Parameters
    ----------
    amounts : pairs of symbol and amount
    energy : photon energies [keV]

    Returns
    -------
    curve [cm^2/g]
    """
    total = np.zeros(len(np.atleast_1d(energy)))
    for element, amount in amounts:
        total += amount * mass_attenuation({element: 1.0}, energy)
    return total


def edges_of(amounts: Amounts) -> tuple[float, ...]:
    """Return the K edges of the elements from 1 to 800 keV.

    Parameters
    ----------
    amounts : pairs of symbol and amount

    Returns
    -------
    energies, ascending [keV]
    """
    return tuple(sorted({edge for element, _ in amounts for edge in k_edges({element: 1.0}, 1.0, 800.0)}))


def to_text(amounts: Amounts) -> str:
    """Write amounts as text such as ``H 0.111898 O 0.888102``, with all digits.

    Parameters
    ----------
    amounts : pairs of symbol and amount

    Returns
    -------
    the text
    """
    return " ".join(f"{element} {float(amount)!r}" for element, amount in amounts)


def from_text(text: str) -> Amounts:
    """Read amounts from the text that `to_text` writes.

    Parameters
    ----------
    text : such as ``H 0.111898 O 0.888102``

    Returns
    -------
    pairs of symbol and amount

    Raises
    ------
    InputError
        When elements and numbers do not alternate.
    """
    words = text.split()
    try:
        return tuple((element, float(amount)) for element, amount in zip(words[::2], words[1::2], strict=True))
    except ValueError:
        raise InputError(f"amounts of elements must read like 'H 0.11 O 0.89', not {text!r}") from None
