"""Search for K edges: one after the other, then all together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import NamedTuple

import numpy as np

from recon.kedge.edge_likelihood import EdgeLikelihood, Functions, moved_edge
from recon.kedge.elements import elements_within, neighbours, scan_elements
from recon.kedge.judgement import JUDGED_RAYS, Judgement, judge_rays
from recon.kedge.profile_likelihood import EdgeProfile, scan_edge, scanned_energies
from recon.kedge.rays import Rays
from spectra.basis.basis import BasisFunction

WIDEST = 5.0  # keV; an edge whose energy is less certain than this is refused; chosen by hand, not measured
NEARBY = 2.0  # keV; half the range in which an edge is refined while the others move; chosen by hand, not measured
NEARBY_ENERGIES = 9  # energies in that range that are tried before the best is refined; chosen by hand, not measured
SETTLED = 0.005  # keV; edges that move by less have converged; chosen by hand, below the Cramer-Rao bounds of presets
ROUNDS = 10  # largest number of times that every edge is refined; chosen by hand, not measured
BESIDE = 4  # elements on either side that are tried while the other edges move; chosen by hand, not measured


@dataclass(frozen=True, eq=False)
class FoundEdge:
    """The most likely further K edge.

    Parameters
    ----------
    plain : functions without the edges to find, that explain the counts best together with it
    function : a step, or an element
    rays : rays on which it was found
    profile : profile likelihood over the energies, or over the elements
    judgement : whether it is warranted
    """

    plain: Functions
    function: BasisFunction
    rays: Rays
    profile: EdgeProfile
    judgement: Judgement

    @property
    def deviance(self) -> float:
        """Deviance of all the rays, with the edge."""
        return self.judgement.deviance_before * self.judgement.rays - self.profile.peak


class FoundStep(NamedTuple):
    """Result of a search for a step.

    Parameters
    ----------
    likelihood : likelihood of the rays that were used
    profile : profile likelihood over the energies
    judgement : whether the step is warranted
    """

    likelihood: EdgeLikelihood
    profile: EdgeProfile
    judgement: Judgement


def likeliest_edge(
    likelihood: EdgeLikelihood,
    choices: Sequence[Functions],
    found: Sequence[BasisFunction],
    edge_shape: BasisFunction,
    starts: Sequence[float],
) -> FoundEdge:
    """Find the step or the element that explains best what the given functions leave unexplained.

    Parameters
    ----------
    likelihood : likelihood of all rays
    choices : alternative functions without the edges to find; a step is tried beside the first alternative, elements
        beside each
    found : edges that were found before
    edge_shape, starts : as in `next_step`

    Returns
    -------
    the edge with the least deviance
    """
    step = next_step(likelihood, (*choices[0], *found), edge_shape, starts)
    chosen = step.likelihood
    moved = moved_edge(edge_shape, step.profile.best)
    tried = [FoundEdge(choices[0], moved, chosen.rays, step.profile, step.judgement)]
    candidates = [f for f in elements_within(likelihood.spectra) if f not in found]
    for plain in choices if candidates else ():
        others = (*plain, *found)
        scan = scan_elements(chosen, others, candidates)
        judgement = judge_rays(chosen, others, scan.function, scan.undetermined)
        tried.append(FoundEdge(plain, scan.function, chosen.rays, scan.profile, judgement))
    return min(tried, key=lambda one: one.deviance)


def next_step(
    likelihood: EdgeLikelihood, functions: Functions, edge_shape: BasisFunction, starts: Sequence[float]
) -> FoundStep:
    """Find the step that explains best what the given functions leave unexplained, and judge it.

    Rays are used whose neighbours these functions explain worst.

    Parameters
    ----------
    likelihood : likelihood of all rays
    functions : the basis so far
    edge_shape : kind and width of the edge
    starts : energies to try besides those of the scan [keV]

    Returns
    -------
    rays, profile and judgement
    """
    worst = likelihood.rays.highest(likelihood.deviances(functions)[0], JUDGED_RAYS)
    chosen = likelihood.with_rays(likelihood.rays[worst])
    energies = scanned_energies(likelihood.spectra, starts)
    profile = scan_edge(chosen, functions, edge_shape, energies)
    flat = profile.sigma > WIDEST or profile.low <= energies[0] or profile.high >= energies[-1]
    undetermined = f"its energy is not determined: {profile.low:.4g} to {profile.high:.4g} keV" if flat else ""
    judgement = judge_rays(chosen, functions, moved_edge(edge_shape, profile.best), undetermined)
    return FoundStep(chosen, profile, judgement)


def refine_together(
    likelihood: EdgeLikelihood, plain: Functions, edges: Sequence[BasisFunction]
) -> list[tuple[BasisFunction, EdgeProfile]]:
    """Refine several edges in turn until none moves; the width of each allows for the others.

    Parameters
    ----------
    likelihood : likelihood of the rays on which any of the edges was found
    plain : functions whose energies are known
    edges : the edges as they were found

    Returns
    -------
    function and profile of each edge
    """
    now = list(edges)
    profiles: dict[int, EdgeProfile] = {}
    for turn in count():
        moved = 0.0
        for i, edge in enumerate(now):
            now[i], profiles[i] = _refined(likelihood, (*plain, *now[:i], *now[i + 1 :]), edge)
            moved = max(moved, abs(profiles[i].best - float(edge.edge_energy or 0.0)))
        if moved < SETTLED or turn + 1 == ROUNDS:
            break
    information = likelihood.edge_information((*plain, *now))[-len(now) :, -len(now) :]
    wider = np.sqrt(np.diagonal(np.linalg.inv(information)) * np.diagonal(information))
    return [(edge, _widened(profiles[i], float(wider[i]))) for i, edge in enumerate(now)]


def _refined(likelihood: EdgeLikelihood, others: Functions, edge: BasisFunction) -> tuple[BasisFunction, EdgeProfile]:
    """The edge at the best energy, or the best element, near where it was."""
    if edge.kind == "element":
        scan = scan_elements(likelihood, others, neighbours(edge, elements_within(likelihood.spectra), BESIDE))
        return scan.function, scan.profile
    energies = float(edge.edge_energy or 0.0) + np.linspace(-NEARBY, NEARBY, NEARBY_ENERGIES)
    profile = scan_edge(likelihood, others, edge, energies)
    return moved_edge(edge, profile.best), profile


def _widened(profile: EdgeProfile, factor: float) -> EdgeProfile:
    """The profile with its interval stretched about the best energy."""
    low, high = (profile.best + factor * (end - profile.best) for end in (profile.low, profile.high))
    return replace(profile, low=low, high=high)
