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

from spectra.elements.formulas import refuse_misread
from spectra.elements.named_materials import LIBRARY, element_number, near
from spectra.errors import InputError

Composition = str | Mapping[str, float]
MassFractions = tuple[tuple[int, float], ...]

# Range of the tables of attenuation that are used [keV].
LOWEST_ENERGY, HIGHEST_ENERGY = 1.0, 800.0
# xraylib's tables jump up to 4 eV beside the edge energies that it reports.
_EDGE_UNCERTAINTY = 0.005
# Attenuations of elements that are kept, as materials share elements and a scene asks at few sets of energies; and most
# energies of such a set.
_KEPT, _MOST_KEPT = 256, 10_000
# Atomic number of the heaviest element of xraylib's tables, californium.
_HEAVIEST = 98


def atomic_number(element: str) -> int:
    """Return the atomic number of an element.

    Parameters
    ----------
    element : symbol

    Returns
    -------
    atomic number

    Raises
    ------
    InputError
        When the element is unknown or heavier than Cf.
    """
    text = str(element).strip()
    if not re.fullmatch(r"[A-Z][a-z]?", text):
        raise _unknown_element(element)
    try:
        number = xraylib.SymbolToAtomicNumber(text)
    except ValueError:
        raise _unknown_element(element) from None
    if number > _HEAVIEST:
        raise InputError(f"there are no attenuation data for {text}, only for H to Cf")
    return number


def edge_energy(element: str) -> float:
    """Return the K edge of an element.

    Parameters
    ----------
    element : symbol

    Returns
    -------
    energy [keV]
    """
    return xraylib.EdgeEnergy(atomic_number(element), xraylib.K_SHELL)


def symbol(number: int) -> str:
    """Return the symbol of an element.

    Parameters
    ----------
    number : atomic number

    Returns
    -------
    symbol
    """
    return xraylib.AtomicNumberToSymbol(number)


def mass_fractions(composition: Composition) -> MassFractions:
    """Compute elements and mass fractions of a formula, a named material, or a mapping of mass fractions.

    Parameters
    ----------
    composition : ``"H2O"``, ``"Water, Liquid"`` (a NIST compound), ``"liver"`` (of `spectra.elements.named_materials`),
        or ``{"H": 0.112, "O": 0.888}`` (must sum to 1 within 1e-3)

    Returns
    -------
    pairs of atomic number and mass fraction

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
    """Return the density of an element or of a named material.

    Parameters
    ----------
    composition : formula, name or mass fractions

    Returns
    -------
    density [g/cm^3]; None for any other formula or a mixture
    """
    fractions = mass_fractions(composition)
    name = composition.strip() if isinstance(composition, str) else ""
    if name in LIBRARY:
        return LIBRARY[name].density
    if name in nist_names():
        return xraylib.GetCompoundDataNISTByName(name)["density"]
    return xraylib.ElementDensity(fractions[0][0]) if len(fractions) == 1 else None


@lru_cache(maxsize=1)
def nist_names() -> tuple[str, ...]:
    """Return the names of the NIST compounds that xraylib knows.

    Returns
    -------
    names
    """
    return tuple(xraylib.GetCompoundDataNISTList())


def k_edges(composition: Composition, low: float, high: float) -> tuple[float, ...]:
    """Return the K edges of a composition that lie strictly between two energies.

    Parameters
    ----------
    composition : formula, name or mass fractions
    low, high : limits [keV]

    Returns
    -------
    energies, ascending [keV]
    """
    edges = (xraylib.EdgeEnergy(number, xraylib.K_SHELL) for number, _ in mass_fractions(composition))
    return tuple(sorted(edge for edge in edges if low < edge < high))


def mass_attenuation(composition: Composition, energy: Float[np.ndarray, " energy"]) -> Float[np.ndarray, " energy"]:
    """Compute the total mass attenuation coefficient mu/rho; at a K edge, its upper side.

    Parameters
    ----------
    composition : formula, name or mass fractions
    energy : photon energies [keV]

    Returns
    -------
    mu/rho [cm^2/g]

    Raises
    ------
    InputError
        When an energy is outside the tables.

    References
    ----------
    xraylib's tables; the module's docstring says how they compare with NIST SRD 126
    """
    energy = np.atleast_1d(np.asarray(energy, dtype=np.float64))
    bad = ~((energy >= LOWEST_ENERGY) & (energy <= HIGHEST_ENERGY))
    if bad.any():
        raise InputError(
            f"attenuation is known from {LOWEST_ENERGY:g} to {HIGHEST_ENERGY:g} keV, not at {energy[bad][0]:g} keV"
        )
    total, energies = np.zeros_like(energy), energy.tobytes()
    of_element = _of_element if energy.size <= _MOST_KEPT else _of_element.__wrapped__
    for number, fraction in mass_fractions(composition):
        total += fraction * of_element(number, energies)
    return total


@lru_cache(maxsize=_KEPT)
def _of_element(number: int, energies: bytes) -> Float[np.ndarray, " energy"]:
    """Total mass attenuation of an element at float64 energies [keV], which are hashed by their bytes [cm^2/g]."""
    energy = np.frombuffer(energies)
    found = xraylib_np.CS_Total(np.array([number]), _off_the_edge(energy, number))[0]
    found.setflags(write=False)
    return found


def linear_attenuation(
    composition: Composition, density: float, energy: Float[np.ndarray, " energy"]
) -> Float[np.ndarray, " energy"]:
    """Compute the linear attenuation coefficient.

    Parameters
    ----------
    composition : formula, name or mass fractions
    density : mass density [g/cm^3]
    energy : photon energies [keV]

    Returns
    -------
    mu [1/mm]
    """
    return mass_attenuation(composition, energy) * (density / 10.0)


def electrons_per_gram(composition: Composition) -> float:
    """Compute the number of electrons per gram of a composition.

    Parameters
    ----------
    composition : formula, name or mass fractions

    Returns
    -------
    electrons [1/g]
    """
    parts = ((n, share / xraylib.AtomicWeight(n)) for n, share in mass_fractions(composition))
    return xraylib.AVOGNUM * 1e24 * sum(n * moles for n, moles in parts)


def attenuation_parts(composition: Composition, energy: Float[np.ndarray, " energy"]) -> Float[np.ndarray, "3 energy"]:
    """Compute the photoelectric, the Compton and the Rayleigh part of the mass attenuation.

    Parameters
    ----------
    composition : formula, name or mass fractions
    energy : photon energies [keV]

    Returns
    -------
    mu / rho of each part [cm^2/g]
    """
    functions = (xraylib_np.CS_Photo, xraylib_np.CS_Compt, xraylib_np.CS_Rayl)
    found = np.zeros((3, len(energy)))
    for number, fraction in mass_fractions(composition):
        found += fraction * np.stack([function(np.array([number]), energy)[0] for function in functions])
    return found


def scattering_functions(
    composition: Composition, transfer: Float[np.ndarray, " x"]
) -> tuple[Float[np.ndarray, " x"], Float[np.ndarray, " x"]]:
    """Compute the incoherent scattering function and the squared form factor of a composition, atom by atom.

    Parameters
    ----------
    composition : formula, name or mass fractions
    transfer : momentum transfer x = sin(theta / 2) / lambda [1/Angstrom]

    Returns
    -------
    S(x) over the number of electrons, 1 for free ones; and F(x)^2 per atom
    """
    atoms = [(n, share / xraylib.AtomicWeight(n)) for n, share in mass_fractions(composition)]
    all_atoms, electrons = (sum(n**power * moles for n, moles in atoms) for power in (0, 1))
    incoherent, squared = np.zeros(len(transfer)), np.zeros(len(transfer))
    for number, moles in atoms:
        incoherent += moles / electrons * np.array([xraylib.SF_Compt(number, x) if x > 0 else 0.0 for x in transfer])
        squared += moles / all_atoms * np.array([xraylib.FF_Rayl(number, x) ** 2 for x in transfer])
    return np.minimum(incoherent, 1.0), squared


def compton_share(composition: Composition, energy: Float[np.ndarray, " energy"]) -> Float[np.ndarray, " energy"]:
    """Compute the fraction of the attenuation that is Compton scattering.

    Parameters
    ----------
    composition : formula, name or mass fractions
    energy : photon energies [keV]

    Returns
    -------
    fraction of each energy
    """
    parts = [
        fraction * xraylib_np.CS_Compt(np.array([number]), energy)[0]
        for number, fraction in mass_fractions(composition)
    ]
    return np.sum(parts, axis=0) / mass_attenuation(composition, energy)


def k_shell_share(
    composition: Composition, number: int, energy: Float[np.ndarray, " energy"]
) -> Float[np.ndarray, " energy"]:
    """Compute the fraction of the attenuation that ionises the K shell of one element.

    Parameters
    ----------
    composition : formula, name or mass fractions
    number : atomic number of the element
    energy : photon energies [keV]

    Returns
    -------
    fraction of each energy

    References
    ----------
    Kissel's cross sections, as xraylib tabulates them
    """
    above = energy > xraylib.EdgeEnergy(number, xraylib.K_SHELL)
    share = np.zeros_like(energy)
    ionised = [xraylib.CS_Photo_Partial(number, xraylib.K_SHELL, float(e)) for e in energy[above]]
    fraction = dict(mass_fractions(composition)).get(number, 0.0)
    share[above] = fraction * np.array(ionised) / mass_attenuation(composition, energy[above])
    return share


def k_lines(number: int) -> tuple[tuple[float, float], ...]:
    """Return the K-alpha and K-beta lines of an element.

    Parameters
    ----------
    number : atomic number

    Returns
    -------
    for each of the two lines: mean energy [keV], and photons per ionised K shell

    References
    ----------
    xraylib's tables
    """
    per_hole = xraylib.FluorYield(number, xraylib.K_SHELL)
    lines = (xraylib.KA_LINE, xraylib.KB_LINE)
    return tuple((xraylib.LineEnergy(number, k), per_hole * xraylib.RadRate(number, k)) for k in lines)


def _off_the_edge(energy: Float[np.ndarray, " energy"], number: int) -> Float[np.ndarray, " energy"]:
    """Energies moved out of the few eV around the K edge where the table may still be on the wrong branch."""
    edge = xraylib.EdgeEnergy(number, xraylib.K_SHELL)
    distance = energy - edge
    side = np.where(distance < 0, -_EDGE_UNCERTAINTY, _EDGE_UNCERTAINTY)
    return np.where(np.abs(distance) < _EDGE_UNCERTAINTY, np.maximum(edge + side, LOWEST_ENERGY), energy)


@lru_cache(maxsize=256)
def _parse(name: str) -> MassFractions:
    """Mass fractions of a named material or a chemical formula."""
    if name in LIBRARY:
        known = LIBRARY[name].composition
        return _parse_formula(known) if isinstance(known, str) else _from_mapping(known)
    return _parse_formula(name)


def _parse_formula(formula: str) -> MassFractions:
    """Mass fractions of a NIST name or a chemical formula."""
    if formula in nist_names():
        data = xraylib.GetCompoundDataNISTByName(formula)
    elif " " in formula:
        raise _unknown_material(formula, "")
    else:
        refuse_misread(formula)
        try:
            data = xraylib.CompoundParser(formula)
        except ValueError as error:
            reason = str(error).removeprefix("Invalid chemical formula").strip(": ")
            raise _unknown_material(formula, reason) from None
    if max(data["Elements"]) > _HEAVIEST:
        raise InputError(f"there are no attenuation data for every element of {formula!r}, only for H to Cf")
    return _normalised(dict(zip(data["Elements"], data["massFractions"], strict=True)))


def _unknown_material(name: str, reason: str) -> InputError:
    """An error that names the material that is meant, where one is close."""
    number = element_number(name)
    meant = symbol(number) if number else near(name, [*LIBRARY, *nist_names()])
    if meant:
        return InputError(f"unknown material {name!r}; did you mean {meant!r}?")
    reason = f" ({reason})" if reason else ""
    return InputError(
        f"unknown material {name!r}{reason}: give a formula, the name of a NIST compound or tissue, or mass fractions"
    )


def _unknown_element(element: str) -> InputError:
    """An error that names the symbol that is meant, where one is."""
    number = element_number(str(element))
    meant = f"did you mean {symbol(number)!r}?" if number else "give its symbol, such as 'Lu'"
    return InputError(f"unknown element {element!r}: {meant}")


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
