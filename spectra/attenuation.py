"""Attenuation of elements, compounds and mixtures: the only module that imports xraylib.

xraylib's total cross sections (photoelectric + Compton + Rayleigh) reproduce the printed NIST SRD 126 values to
0.065 %; independent tables differ from both by 1 to 5 % near K edges, which is the real uncertainty there.
"""

import re
from collections.abc import Mapping
from functools import lru_cache

import numpy as np
import xraylib
import xraylib_np
from jaxtyping import Float

from spectra.errors import InputError

Composition = str | Mapping[str, float]
MassFractions = tuple[tuple[int, float], ...]

LOWEST_ENERGY, HIGHEST_ENERGY = 1.0, 800.0
# xraylib's tables jump up to 4 eV beside the edge energies that it reports.
_EDGE_UNCERTAINTY = 0.005
_HEAVIEST = 98


def atomic_number(element: str) -> int:
    """Atomic number of an element's symbol."""
    symbol = str(element).strip()
    if not re.fullmatch(r"[A-Z][a-z]?", symbol):
        raise InputError(f"unknown element {element!r}: give its symbol, such as 'Lu'")
    try:
        number = xraylib.SymbolToAtomicNumber(symbol)
    except ValueError:
        raise InputError(f"unknown element {element!r}: give its symbol, such as 'Lu'") from None
    if number > _HEAVIEST:
        raise InputError(f"there are no attenuation data for {symbol}, only for H to Cf")
    return number


def edge_energy(element: str) -> float:
    """K edge of an element [keV]."""
    return xraylib.EdgeEnergy(atomic_number(element), xraylib.K_SHELL)


def symbol(number: int) -> str:
    """Symbol of an element by its atomic number."""
    return xraylib.AtomicNumberToSymbol(number)


def mass_fractions(composition: Composition) -> MassFractions:
    """Elements and mass fractions of a formula, a NIST compound name, or a mapping of mass fractions.

    Parameters
    ----------
    composition : ``"H2O"``, ``"Water, Liquid"``, or ``{"H": 0.112, "O": 0.888}`` (must sum to 1 within 1e-3)

    Raises
    ------
    InputError
        Also for formulas that xraylib would accept and misread: dopants such as ``CsI(Tl)``, hydrates such as
        ``CaSO4.2H2O``, mass fractions written as subscripts.
    """
    if isinstance(composition, str):
        return _parse(composition.strip())
    return _from_mapping(composition)


def natural_density(composition: Composition) -> float | None:
    """Density of a pure element or NIST compound [g/cm^3]; None for a formula or a mixture."""
    fractions = mass_fractions(composition)
    if len(fractions) == 1:
        return xraylib.ElementDensity(fractions[0][0])
    nist = isinstance(composition, str) and composition.strip() in _nist_names()
    return xraylib.GetCompoundDataNISTByName(str(composition).strip())["density"] if nist else None


def k_edges(composition: Composition, low: float, high: float) -> tuple[float, ...]:
    """K edges of the elements of a composition that lie strictly between two energies [keV], ascending."""
    edges = (xraylib.EdgeEnergy(number, xraylib.K_SHELL) for number, _ in mass_fractions(composition))
    return tuple(sorted(edge for edge in edges if low < edge < high))


def mass_attenuation(composition: Composition, energy: Float[np.ndarray, " energy"]) -> Float[np.ndarray, " energy"]:
    """Total mass attenuation coefficient mu/rho [cm^2/g] at `energy` [keV]; at a K edge, its upper side."""
    energy = np.atleast_1d(np.asarray(energy, dtype=np.float64))
    bad = ~((energy >= LOWEST_ENERGY) & (energy <= HIGHEST_ENERGY))
    if bad.any():
        raise InputError(
            f"attenuation is known from {LOWEST_ENERGY:g} to {HIGHEST_ENERGY:g} keV, not at {energy[bad][0]:g} keV"
        )
    total = np.zeros_like(energy)
    for number, fraction in mass_fractions(composition):
        total += fraction * xraylib_np.CS_Total(np.array([number]), _off_the_edge(energy, number))[0]
    return total


def linear_attenuation(
    composition: Composition, density: float, energy: Float[np.ndarray, " energy"]
) -> Float[np.ndarray, " energy"]:
    """Linear attenuation coefficient [1/mm] at `energy` [keV] for a density in g/cm^3."""
    return mass_attenuation(composition, energy) * (density / 10.0)


def _off_the_edge(energy: Float[np.ndarray, " energy"], number: int) -> Float[np.ndarray, " energy"]:
    """Energies moved out of the few eV around the K edge where the table may still be on the wrong branch."""
    edge = xraylib.EdgeEnergy(number, xraylib.K_SHELL)
    distance = energy - edge
    side = np.where(distance < 0, -_EDGE_UNCERTAINTY, _EDGE_UNCERTAINTY)
    return np.where(np.abs(distance) < _EDGE_UNCERTAINTY, np.maximum(edge + side, LOWEST_ENERGY), energy)


@lru_cache(maxsize=256)
def _parse(formula: str) -> MassFractions:
    """Mass fractions of a NIST name or a chemical formula."""
    if formula in _nist_names():
        data = xraylib.GetCompoundDataNISTByName(formula)
    else:
        _refuse_misread(formula)
        try:
            data = xraylib.CompoundParser(formula)
        except ValueError as error:
            reason = str(error).removeprefix("Invalid chemical formula: ").strip()
            raise InputError(
                f"unknown material {formula!r} ({reason}): give a formula, a NIST compound name or mass fractions"
            ) from None
    if max(data["Elements"]) > _HEAVIEST:
        raise InputError(f"there are no attenuation data for every element of {formula!r}, only for H to Cf")
    return _normalised(dict(zip(data["Elements"], data["massFractions"], strict=True)))


def _from_mapping(composition: Mapping[str, float]) -> MassFractions:
    """Checked mass fractions of a mapping."""
    if not composition:
        raise InputError("a composition needs at least one element")
    fractions = {atomic_number(element): float(fraction) for element, fraction in composition.items()}
    if not all(0 <= fraction <= 1 for fraction in fractions.values()):
        raise InputError(f"mass fractions must lie between 0 and 1, got {dict(composition)}")
    total = sum(fractions.values())
    if abs(total - 1) > 1e-3:
        raise InputError(f"mass fractions must sum to 1, those of {', '.join(composition)} sum to {total:g}")
    return _normalised(fractions)


def _normalised(fractions: Mapping[int, float]) -> MassFractions:
    """Fractions that sum to one, without elements that are absent."""
    total = sum(fractions.values())
    return tuple((number, fraction / total) for number, fraction in sorted(fractions.items()) if fraction > 0)


def _refuse_misread(formula: str) -> None:
    """Refuse formulas that parse but do not mean what they seem to say."""
    hint = "give mass fractions instead, such as {'H': 0.112, 'O': 0.888}"
    if re.search(r"\)(?![\d])", formula):
        raise InputError(f"the bracket in {formula!r} has no number behind it, which would mean one whole unit: {hint}")
    subscripts = [float(number) for number in re.findall(r"\d*\.?\d+", formula)]
    if re.search(r"[1-9]\d*\.\d", formula):
        raise InputError(f"the decimal point in {formula!r} reads like a hydrate: {hint}")
    symbols = len(re.findall(r"[A-Z][a-z]?", formula))
    if "." in formula and len(subscripts) == symbols and abs(sum(subscripts) - 1) < 1e-2:
        raise InputError(f"the numbers in {formula!r} would be taken as atoms, not as mass fractions: {hint}")


@lru_cache(maxsize=1)
def _nist_names() -> frozenset[str]:
    """Names of the NIST compounds that xraylib knows."""
    return frozenset(xraylib.GetCompoundDataNISTList())
