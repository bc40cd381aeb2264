"""The element that has the K edge in the counts: total attenuation of one element after the other.

A step is 0 below its edge, while an element attenuates there as well, and above it not by the cube of the energy. Where
the object has real compositions, a step therefore finds a wrong energy, and elements are tried beside it. Water and
bone then describe tissues better than photoelectric absorption and Compton scattering, which no material follows
exactly: both pairs are tried.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from phantomgen.dataset.spectral_model import Spectra
from recon.kedge.edge_likelihood import EdgeLikelihood, Functions
from recon.kedge.profile_likelihood import EdgeProfile, detected_range
from spectra.basis.basis import BasisFunction
from spectra.elements.attenuation import edge_energy, symbol

# atomic numbers: Sc to Bi, Th and U, without those that decay: Tc, Pm
NUMBERS = tuple(z for z in (*range(21, 84), 90, 92) if z not in (43, 61))
# no unit; elements whose deviances differ by less are not distinguished; three standard deviations
INDISTINCT = 9.0
# names of `spectra.elements.named_materials`; the alternative to photoelectric absorption and Compton scattering;
# docs/reference/benchmarks/kedge_search.md has the deviances of both on `multi-energy`
TISSUES = ("Water, Liquid", "cortical bone")


class ElementScan(NamedTuple):
    """Result of a scan over elements.

    Parameters
    ----------
    function : the most likely element
    profile : profile likelihood over the edges of all elements
    undetermined : why the element is not determined; empty where it is
    """

    function: BasisFunction
    profile: EdgeProfile
    undetermined: str


def plain_alternatives(functions: Functions) -> tuple[Functions, ...]:
    """List alternatives to photoelectric absorption and Compton scattering at the beginning of a basis.

    Parameters
    ----------
    functions : a basis

    Returns
    -------
    the basis itself, and with water and bone in their place if it begins with them
    """
    if tuple(f.kind for f in functions[:2]) != ("photoelectric", "compton"):
        return (functions,)
    tissues = tuple(BasisFunction("material", composition=name) for name in TISSUES)
    return functions, (*tissues, *functions[2:])


def elements_within(spectra: Spectra) -> tuple[BasisFunction, ...]:
    """List the elements whose K edge may be seen.

    Parameters
    ----------
    spectra : spectral model of the scan

    Returns
    -------
    functions of the elements, by atomic number
    """
    low, high = detected_range(spectra)
    return tuple(BasisFunction("element", element=symbol(z)) for z in NUMBERS if low < edge_energy(symbol(z)) < high)


def scan_elements(likelihood: EdgeLikelihood, functions: Functions, candidates: Sequence[BasisFunction]) -> ElementScan:
    """Find the element that explains best what the given functions leave unexplained.

    Parameters
    ----------
    likelihood : likelihood of the rays
    functions : the other functions of the basis
    candidates : elements to try, by atomic number; those among `functions` are left out

    Returns
    -------
    the element and its profile

    Notes
    -----
    No element has an edge between those of two others in the list. One standard deviation is where the parabola through
    the best element and its neighbour in the list has fallen by 1.
    """
    taken = {f.element for f in functions}
    tried = [f for f in candidates if f.element not in taken]
    saved_by = likelihood.saving(functions)
    saved = np.array([_sum(*saved_by(function)) for function in tried])
    energies = np.array([float(f.edge_energy or 0.0) for f in tried])
    best = int(saved.argmax())
    low, high = (_fallen(energies, saved, best, side) for side in (-1, 1))
    bound = likelihood.edge_bound((*functions, tried[best]))
    profile = EdgeProfile(energies, saved, float(energies[best]), low, high, bound, len(likelihood.rays))
    alike = [str(f.element) for f, value in zip(tried, saved, strict=True) if value > saved[best] - INDISTINCT]
    undetermined = f"its element is not determined: {alike[0]} to {alike[-1]}" if len(alike) > 2 else ""
    return ElementScan(tried[best], profile, undetermined)


def settle_elements(
    likelihood: EdgeLikelihood, plain: Functions, found: Sequence[BasisFunction], rounds: int
) -> list[BasisFunction]:
    """Choose each element again beside all others until none changes; functions of other kinds stay.

    The first element is chosen while the others are missing, and is often one that represents them all.

    Parameters
    ----------
    likelihood : likelihood of the rays
    plain : functions without the edges to find
    found : edges that were found
    rounds : largest number of times that every element is chosen

    Returns
    -------
    the edges with the elements that were chosen
    """
    candidates = elements_within(likelihood.spectra)
    now = list(found)
    for _ in range(rounds):
        before = list(now)
        for i, function in enumerate(now):
            if function.kind == "element":
                others = (*plain, *now[:i], *now[i + 1 :])
                now[i] = _best(likelihood, others, candidates)
        if now == before:
            break
    return now


def neighbours(element: BasisFunction, candidates: Sequence[BasisFunction], count: int) -> list[BasisFunction]:
    """List an element and its neighbours.

    Parameters
    ----------
    element : the element
    candidates : all elements, by atomic number
    count : number of neighbours on either side

    Returns
    -------
    the element and its neighbours, by atomic number
    """
    place = list(candidates).index(element)
    return list(candidates[max(place - count, 0) : place + count + 1])


def _best(likelihood: EdgeLikelihood, others: Functions, candidates: Sequence[BasisFunction]) -> BasisFunction:
    """The candidate with the largest drop in deviance."""
    saved_by = likelihood.saving(others)
    taken = {f.element for f in others}
    return max((f for f in candidates if f.element not in taken), key=lambda f: _sum(*saved_by(f)))


def _sum(drops: np.ndarray, lengths: np.ndarray) -> float:
    """Sum of the drops in deviance; 0 where line integrals sum up to less than 0, or their fit did not converge."""
    total = float(drops.sum())
    return total if np.isfinite(total) and lengths.sum() > 0 else 0.0


def _fallen(energies: np.ndarray, saved: np.ndarray, best: int, side: int) -> float:
    """Energy where a parabola through the best element and the next has fallen by 1; the best edge without a next."""
    beside = best + side
    if not 0 <= beside < len(energies):
        return float(energies[best])
    drop = max(float(saved[best] - saved[beside]), 1.0)
    return float(energies[best] + (energies[beside] - energies[best]) / np.sqrt(drop))
