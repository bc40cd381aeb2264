"""K edges found one after the other, then refined together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from recon.kedge.alternatives import drops
from recon.kedge.elements import elements_within, neighbours, scan_elements
from recon.kedge.expected_noise import excess_score, null_law
from recon.kedge.neighbour_agreement import agreement
from recon.kedge.profile_likelihood import (
    EdgeLikelihood,
    EdgeProfile,
    Functions,
    moved_edge,
    scan_edge,
    scanned_energies,
)
from recon.kedge.rays import Rays
from spectra.basis.basis import BasisFunction

RAYS = 2000  # that are judged, at most
FEWER = (1, 4, 16)  # parts of these that are judged, too, as a thin vessel fills few
POOL = 8000  # rays of which those are chosen
WARRANTED = 5.0  # standard deviations of noise that a further basis must save
WIDEST = 5.0  # an edge whose energy is less certain than this is not located [keV]
NEARBY = 2.0  # half the range in which an edge is refined while the others move [keV]
SETTLED = 0.005  # edges that move less are refined [keV]
ROUNDS = 10  # of refining one edge after the other
BESIDE = 4  # elements on either side that are tried while the other edges move


@dataclass(frozen=True)
class Judgement:
    """Whether one further basis function is warranted.

    Parameters
    ----------
    name : of the function
    edge : its K edge [keV]
    before : names of the functions that it is added to
    rays : how many were judged
    deviance_before, deviance_after : mean per ray beside those, without it and with it
    saved : mean drop in deviance per ray, beside those or other functions without an edge, whichever explain a ray best
    noise : what noise alone saves
    score : by how many standard deviations of noise more was saved than noise and a conceded misfit do, see
        `recon.kedge.expected_noise`; where neighbouring rays were asked, how well they agree
    warranted : whether it is taken
    reason : why, in words
    """

    name: str
    edge: float
    before: tuple[str, ...]
    rays: int
    deviance_before: float
    deviance_after: float
    saved: float
    noise: float
    score: float
    warranted: bool
    reason: str


def judge(likelihood: EdgeLikelihood, functions: Functions, further: BasisFunction) -> Judgement:
    """Whether a function at a known energy is warranted, on the rays whose neighbours it saves most.

    A ray's own noise has no part in the choice. Neighbours are asked twice: beside these functions on all rays, then,
    on the rays that are left, beside other functions without an edge, too, so that metal does not displace vessels.
    """
    saved, lengths = likelihood.saving(functions)(further)
    saved = np.where((lengths > 0) & (saved > 0), saved, 0.0)
    pool = likelihood.with_rays(likelihood.rays[likelihood.rays.highest(saved, POOL)])
    return _judged(pool, functions, further, "", choose=True)


def judge_weak(
    likelihood: EdgeLikelihood, functions: Functions, further: BasisFunction, before: Judgement
) -> Judgement:
    """Judge a function again that no single ray shows, by whether neighbouring rays agree.

    Parameters
    ----------
    likelihood : of rays that are not binned
    functions, further : as in `judge`
    before : what `judge` said
    """
    score = agreement(likelihood, functions, further)
    many = f"neighbours among {len(likelihood.rays)} rays agree on it by {score:.1f} standard deviations of noise"
    if score < WARRANTED:
        return replace(before, reason=f"{before.reason}; {many}")
    return replace(before, score=score, warranted=True, reason=many)


@dataclass(frozen=True, eq=False)
class FoundEdge:
    """The likeliest further K edge.

    Parameters
    ----------
    plain : functions without the edges that explain the counts best together with it
    function : a step, or an element
    rays : on which it was found
    profile : over the energies, or over the elements
    judgement : whether it is warranted
    """

    plain: Functions
    function: BasisFunction
    rays: Rays
    profile: EdgeProfile
    judgement: Judgement

    @property
    def deviance(self) -> float:
        """Of all the rays, with the edge."""
        return self.judgement.deviance_before * self.judgement.rays - self.profile.peak


def likeliest_edge(
    likelihood: EdgeLikelihood,
    choices: Sequence[Functions],
    found: Sequence[BasisFunction],
    like: BasisFunction,
    starts: Sequence[float],
) -> FoundEdge:
    """The step or the element that explains best what these functions fail to explain.

    Parameters
    ----------
    likelihood : of all rays
    choices : functions without the edges that are looked for; a step is tried beside the first, elements beside each
    found : edges that were found before
    like, starts : as in `next_edge`
    """
    chosen, profile, judgement = next_edge(likelihood, (*choices[0], *found), like, starts)
    tried = [FoundEdge(choices[0], moved_edge(like, profile.best), chosen.rays, profile, judgement)]
    candidates = [f for f in elements_within(likelihood.spectra) if f not in found]
    for plain in choices if candidates else ():
        others = (*plain, *found)
        function, profile, vague = scan_elements(chosen, others, candidates)
        judgement = _judged(chosen, others, function, vague)
        tried.append(FoundEdge(plain, function, chosen.rays, profile, judgement))
    return min(tried, key=lambda one: one.deviance)


def next_edge(
    likelihood: EdgeLikelihood, functions: Functions, like: BasisFunction, starts: Sequence[float]
) -> tuple[EdgeLikelihood, EdgeProfile, Judgement]:
    """The edge that explains best what these functions fail to explain, and whether it is warranted.

    Parameters
    ----------
    likelihood : of all rays
    functions : the basis so far
    like : kind and width of the edge
    starts : energies that are tried besides those of the scan [keV]

    Returns
    -------
    the likelihood of the rays that were used, the profile, and the judgement
    """
    chosen = likelihood.with_rays(likelihood.worst(functions, RAYS))
    energies = scanned_energies(likelihood.spectra, starts)
    profile = scan_edge(chosen, functions, like, energies)
    flat = profile.sigma > WIDEST or profile.low <= energies[0] or profile.high >= energies[-1]
    vague = f"its energy is not determined: {profile.low:.4g} to {profile.high:.4g} keV" if flat else ""
    return chosen, profile, _judged(chosen, functions, moved_edge(like, profile.best), vague)


def refine_together(
    likelihood: EdgeLikelihood, plain: Functions, edges: Sequence[BasisFunction]
) -> list[tuple[BasisFunction, EdgeProfile]]:
    """Refine several edges in turn until none moves; the width of each allows for the others.

    Parameters
    ----------
    likelihood : of the rays that any of the edges was found on
    plain : functions whose energies are known
    edges : where each was found
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
        near = neighbours(edge, elements_within(likelihood.spectra), BESIDE)
        return scan_elements(likelihood, others, near)[:2]
    profile = scan_edge(likelihood, others, edge, float(edge.edge_energy or 0.0) + np.linspace(-NEARBY, NEARBY, 9))
    return moved_edge(edge, profile.best), profile


def _widened(profile: EdgeProfile, factor: float) -> EdgeProfile:
    """The profile with its interval stretched about the best energy."""
    low, high = (profile.best + factor * (end - profile.best) for end in (profile.low, profile.high))
    return replace(profile, low=low, high=high)


def _judged(
    likelihood: EdgeLikelihood, functions: Functions, further: BasisFunction, vague: str, choose: bool = False
) -> Judgement:
    """What the function saves with coefficients that are not negative, and whether that is more than noise.

    With `choose`, rays are those whose neighbours it saves most, as many as show it best.
    """
    saved, _ = drops(likelihood, functions, further)
    before, lengths = likelihood.deviances(functions)
    law = null_law(likelihood, functions, further, lengths)
    rays = np.arange(len(saved))
    if choose and len(rays) > RAYS // max(FEWER):
        ranked = likelihood.rays.highest(saved, RAYS)
        choices = [ranked[: RAYS // part] for part in FEWER]
        rays = max(choices, key=lambda some: excess_score(saved[some], law[some]))
    score = excess_score(saved[rays], law[rays])
    after = likelihood.with_rays(likelihood.rays[rays]).deviances((*functions, further))[0]
    means = [float(values.mean()) if len(rays) else 0.0 for values in (before[rays], after, saved[rays])]
    noise = float(law.variance[rays].mean() / 2) if len(rays) else 0.0
    if not len(rays):
        reason = "no ray passes through the object away from its edges"
    elif score < WARRANTED:
        reason = (
            f"it saves {means[2]:.3g} per ray, where noise saves {noise:.3g}: {score:.1f} standard deviations more, "
            f"fewer than {WARRANTED:g}"
        )
    else:
        reason = vague or (
            f"it saves {means[2]:.3g} per ray, where noise saves {noise:.3g}: {score:.1f} standard deviations more"
        )
    names = tuple(f.name for f in functions)
    return Judgement(
        further.name, float(further.edge_energy or np.nan), names, len(rays), means[0], means[1], means[2], noise,
        score, bool(score >= WARRANTED and not vague), reason,
    )  # fmt: skip
