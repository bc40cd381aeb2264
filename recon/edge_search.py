"""K edges found one after the other, then refined together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from recon.edge_agreement import agreement
from recon.edge_elements import elements_within, neighbours, scan_elements
from recon.edge_profile import EdgeLikelihood, EdgeProfile, Functions, moved_edge, scan_edge, scanned_energies
from recon.edge_rays import Rays
from spectra.basis import BasisFunction

RAYS = 2000  # that are judged, those that the smaller basis explains worst
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
    deviance_before, deviance_after : mean per ray, without it and with it
    saved : mean drop in deviance per ray; noise alone gives 1/2
    score : what that is in standard deviations of noise; where neighbouring rays were asked, how well they agree
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
    score: float
    warranted: bool
    reason: str


def noise_score(saved: float, rays: int) -> float:
    """What a drop in deviance, summed over so many rays, is in standard deviations of noise; see `docs/edge_energy.md`.

    On a ray that does not need the function, the drop is 0 or, as often, chi-square with one degree of freedom, because
    coefficients must not be negative (Self & Liang 1987, doi:10.1080/01621459.1987.10478472, case 5): mean 1/2,
    variance 5/4.
    """
    return (saved - rays / 2) / np.sqrt(1.25 * rays) if rays else 0.0


def judge(likelihood: EdgeLikelihood, functions: Functions, further: BasisFunction) -> Judgement:
    """Whether a function at a known energy is warranted, on the rays that the others explain worst."""
    chosen = likelihood.with_rays(likelihood.worst(functions, RAYS))
    return _judged(chosen, functions, further, "")


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


def _judged(likelihood: EdgeLikelihood, functions: Functions, further: BasisFunction, vague: str) -> Judgement:
    """What the function saves with coefficients that are not negative, and whether that is more than noise."""
    rays = len(likelihood.rays)
    drops, lengths = likelihood.saving(functions)(further)
    saved = float(np.maximum(drops, 0.0).sum(where=lengths > 0))
    score = noise_score(saved, rays)
    before = likelihood.deviances(functions)[0]
    mean = float(before.mean()) if rays else 0.0
    drop = saved / rays if rays else 0.0
    if not rays:
        reason = "no ray passes through the object away from its edges"
    elif score < WARRANTED:
        reason = f"it saves {drop:.3g} per ray, {score:.1f} standard deviations of noise, fewer than {WARRANTED:g}"
    else:
        reason = vague or f"it saves {drop:.3g} per ray, {score:.1f} standard deviations of noise"
    names = tuple(f.name for f in functions)
    return Judgement(
        further.name, float(further.edge_energy or np.nan), names, rays, mean, mean - drop, drop, score,
        score >= WARRANTED and not vague, reason,
    )  # fmt: skip
