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
    """Mass fractions by symbol of a name, a formula or a mapping."""
    return tuple((symbol(number), share) for number, share in mass_fractions(composition))


def added(parts: Iterable[tuple[Amounts, float]]) -> Amounts:
    """Sum of amounts, each times a factor."""
    total: dict[str, float] = {}
    for amounts, factor in parts:
        for element, amount in amounts:
            total[element] = total.get(element, 0.0) + factor * amount
    return tuple(total.items())


def curve(amounts: Amounts, energy: EnergyArray) -> EnergyArray:
    """Sum of amounts times mu/rho [cm^2/g] at `energy` [keV]."""
    total = np.zeros(len(np.atleast_1d(energy)))
    for element, amount in amounts:
        total += amount * mass_attenuation({element: 1.0}, energy)
    return total


def edges_of(amounts: Amounts) -> tuple[float, ...]:
    """K edges of the elements from 1 to 800 keV, ascending [keV]."""
    return tuple(sorted({edge for element, _ in amounts for edge in k_edges({element: 1.0}, 1.0, 800.0)}))


def to_text(amounts: Amounts) -> str:
    """Such as ``H 0.111898 O 0.888102``, with all digits."""
    return " ".join(f"{element} {float(amount)!r}" for element, amount in amounts)


def from_text(text: str) -> Amounts:
    """What `to_text` wrote.

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
