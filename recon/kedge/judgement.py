"""Whether the counts warrant a further basis function: by single rays, or by the correlation of neighbouring rays."""

from dataclasses import dataclass, replace

import numpy as np

from recon.kedge.alternatives import deviance_drops
from recon.kedge.edge_likelihood import EdgeLikelihood, Functions
from recon.kedge.expected_noise import excess_score, null_distribution
from recon.kedge.spatial_correlation import correlation_score
from spectra.basis.basis import BasisFunction

JUDGED_RAYS = 2000  # rays; largest number that is judged; chosen by hand, not measured
# no unit; fractions 1/n of these that are judged, too, as a thin vessel fills few rays; chosen by hand, not measured
RAY_FRACTIONS = (1, 4, 16)
POOL_RAYS = 8000  # rays from which those are chosen; chosen by hand, not measured
# standard deviations of noise that a further function must save; chance to find a vial and rate of false edges:
# `python -m benchmarks.reconstruction.kedge_power`
LEAST_SCORE = 5.0


@dataclass(frozen=True)
class Judgement:
    """Whether one further basis function is warranted.

    Parameters
    ----------
    name : name of the function
    edge : energy of its K edge [keV]
    before : names of the functions that it is added to
    rays : number of rays that were judged
    deviance_before, deviance_after : mean deviance per ray with those functions, without and with the further one
    saved : mean drop in deviance per ray, beside those or other functions without an edge, whichever explain a ray best
    noise : mean drop in deviance per ray that noise alone gives
    score : by how many standard deviations of noise `saved` exceeds what noise and a conceded misfit give, see
        `recon.kedge.expected_noise`; where neighbouring rays decide, how well they agree
    warranted : whether the function is taken
    reason : explanation for a user
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
    """Judge a function at a known energy, on the rays with the largest drop in deviance among their neighbours.

    The noise of a ray takes no part in its choice. Rays are chosen twice: first by the drop beside these functions on
    all rays, then, among those, by the drop beside other functions without an edge as well, so that metal does not
    displace vessels.

    Parameters
    ----------
    likelihood : likelihood of all rays
    functions : the basis so far
    further : the function to judge

    Returns
    -------
    the judgement
    """
    saved, lengths = likelihood.saving(functions)(further)
    saved = np.where((lengths > 0) & (saved > 0), saved, 0.0)
    pool = likelihood.with_rays(likelihood.rays[likelihood.rays.highest(saved, POOL_RAYS)])
    return judge_rays(pool, functions, further, choose=True)


def judge_by_neighbours(
    likelihood: EdgeLikelihood, functions: Functions, further: BasisFunction, before: Judgement
) -> Judgement:
    """Judge a function again that no single ray shows, by whether neighbouring rays agree.

    Parameters
    ----------
    likelihood : likelihood of rays that are not binned
    functions, further : as in `judge`
    before : the result of `judge`

    Returns
    -------
    the new judgement, or `before` with a longer explanation where they do not agree
    """
    score = correlation_score(likelihood, functions, further)
    many = f"neighbours among {len(likelihood.rays)} rays agree on it by {score:.1f} standard deviations of noise"
    if score < LEAST_SCORE:
        return replace(before, reason=f"{before.reason}; {many}")
    return replace(before, score=score, warranted=True, reason=many)


def judge_rays(
    likelihood: EdgeLikelihood,
    functions: Functions,
    further: BasisFunction,
    undetermined: str = "",
    choose: bool = False,
) -> Judgement:
    """Judge whether a function with non-negative line integrals saves more deviance than noise.

    Parameters
    ----------
    likelihood : likelihood of the rays to judge, or to choose from
    functions : the basis so far
    further : the function to judge
    undetermined : why its energy or element is not determined, so that it is not taken; empty where it is
    choose : whether to judge those rays only whose neighbours have the largest drop, as many as show it best

    Returns
    -------
    the judgement
    """
    saved = deviance_drops(likelihood, functions, further)
    before, lengths = likelihood.deviances(functions)
    null = null_distribution(likelihood, functions, further, lengths)
    rays = np.arange(len(saved))
    if choose and len(rays) > JUDGED_RAYS // max(RAY_FRACTIONS):
        ranked = likelihood.rays.highest(saved, JUDGED_RAYS)
        choices = [ranked[: JUDGED_RAYS // part] for part in RAY_FRACTIONS]
        rays = max(choices, key=lambda some: excess_score(saved[some], null[some]))
    score = excess_score(saved[rays], null[rays])
    after = likelihood.with_rays(likelihood.rays[rays]).deviances((*functions, further))[0]
    means = [float(values.mean()) if len(rays) else 0.0 for values in (before[rays], after, saved[rays])]
    noise = float(null.variance[rays].mean() / 2) if len(rays) else 0.0
    more = f"it saves {means[2]:.3g} per ray, where noise saves {noise:.3g}: {score:.1f} standard deviations more"
    if not len(rays):
        reason = "no ray passes through the object away from its edges"
    elif score < LEAST_SCORE:
        reason = f"{more}, fewer than {LEAST_SCORE:g}"
    else:
        reason = undetermined or more
    names = tuple(f.name for f in functions)
    return Judgement(
        further.name, float(further.edge_energy or np.nan), names, len(rays), means[0], means[1], means[2], noise,
        score, bool(score >= LEAST_SCORE and not undetermined), reason,
    )  # fmt: skip
