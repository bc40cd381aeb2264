"""Which element has the K edge that counts show: total attenuation of one element after the other.

A step is 0 below its edge, while an element attenuates there, too, and not by the cube of the energy. Where a scan
holds real compositions, a step therefore finds a wrong energy, and elements are tried beside it. Water and bone then
say more of tissues than photoelectric effect and Compton scattering, which no material follows exactly: each is tried.
"""

from collections.abc import Sequence

import numpy as np

from phantomgen.dataset.spectral_model import Spectra
from recon.kedge.profile_likelihood import STEP, EdgeLikelihood, EdgeProfile, Functions, edge_bound
from spectra.basis.basis import BasisFunction
from spectra.elements.attenuation import edge_energy, symbol

# Sc to Bi, Th and U, without those that decay: Tc, Pm.
NUMBERS = tuple(z for z in (*range(21, 84), 90, 92) if z not in (43, 61))
ALIKE = 9.0  # of two elements whose deviances differ by less, either may be meant: three standard deviations
TISSUES = ("Water, Liquid", "cortical bone")


def plain_alternatives(functions: Functions) -> tuple[Functions, ...]:
    """These functions; and with water and bone where they begin with photoelectric effect and Compton scattering."""
    if tuple(f.kind for f in functions[:2]) != ("photoelectric", "compton"):
        return (functions,)
    tissues = tuple(BasisFunction("material", composition=name) for name in TISSUES)
    return functions, (*tissues, *functions[2:])


def elements_within(spectra: Spectra) -> tuple[BasisFunction, ...]:
    """Functions of all elements whose K edge may be seen, by atomic number."""
    seen = np.flatnonzero(spectra.weights.any(axis=0))
    low, high = spectra.edges[seen[0]] + STEP, spectra.edges[seen[-1] + 1] - STEP
    return tuple(BasisFunction("element", element=symbol(z)) for z in NUMBERS if low < edge_energy(symbol(z)) < high)


def scan_elements(
    likelihood: EdgeLikelihood, functions: Functions, candidates: Sequence[BasisFunction]
) -> tuple[BasisFunction, EdgeProfile, str]:
    """The element that explains best what these functions fail to explain.

    Parameters
    ----------
    likelihood : of the rays
    functions : the other functions of the basis
    candidates : elements to try, by atomic number; those among `functions` are left out

    Returns
    -------
    the element's function, the profile over the edges of all of them, and why the element is not determined, or ""

    Notes
    -----
    An element has no edge between two others. One sigma is where the parabola through the best element and its
    neighbour in the list has fallen by 1.
    """
    taken = {f.element for f in functions}
    tried = [f for f in candidates if f.element not in taken]
    each = likelihood.saving(functions)
    saved = np.array([_sum(*each(function)) for function in tried])
    energies = np.array([float(f.edge_energy or 0.0) for f in tried])
    best = int(saved.argmax())
    low, high = (_fallen(energies, saved, best, side) for side in (-1, 1))
    bound = edge_bound(likelihood, (*functions, tried[best]))
    profile = EdgeProfile(energies, saved, float(energies[best]), low, high, bound, len(likelihood.rays))
    alike = [str(f.element) for f, value in zip(tried, saved, strict=True) if value > saved[best] - ALIKE]
    vague = f"its element is not determined: {alike[0]} to {alike[-1]}" if len(alike) > 2 else ""
    return tried[best], profile, vague


def settle_elements(
    likelihood: EdgeLikelihood, plain: Functions, found: Sequence[BasisFunction], rounds: int
) -> list[BasisFunction]:
    """Choose each element anew beside all others until none changes; functions of other kinds stay.

    The first element is chosen while the others are missing, and is often one that stands for them all.
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
    """Elements so many places or fewer away in the list, and itself."""
    place = list(candidates).index(element)
    return list(candidates[max(place - count, 0) : place + count + 1])


def _best(likelihood: EdgeLikelihood, others: Functions, candidates: Sequence[BasisFunction]) -> BasisFunction:
    """The candidate that explains most."""
    each = likelihood.saving(others)
    taken = {f.element for f in others}
    return max((f for f in candidates if f.element not in taken), key=lambda f: _sum(*each(f)))


def _sum(drops: np.ndarray, lengths: np.ndarray) -> float:
    """Drop in deviance; nothing where the element would have to be taken away, or line integrals were not found."""
    total = float(drops.sum())
    return total if np.isfinite(total) and lengths.sum() > 0 else 0.0


def _fallen(energies: np.ndarray, saved: np.ndarray, best: int, side: int) -> float:
    """Where a parabola through the best element and the next one has fallen by 1; the last edge where there is none."""
    beside = best + side
    if not 0 <= beside < len(energies):
        return float(energies[best])
    drop = max(float(saved[best] - saved[beside]), 1.0)
    return float(energies[best] + (energies[beside] - energies[best]) / np.sqrt(drop))
