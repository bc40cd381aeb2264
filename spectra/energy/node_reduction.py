"""Few energy nodes in place of many.

The counts of a channel, sum_k w_k exp(-B_k . L), are wanted only for line integrals L in a box that the scene can
reach. There a handful of free nodes (weight and columns) does as well as hundreds: a Gauss rule for sums of
exponentials. Neighbours among the given nodes are merged two by two, and all weights and columns of what is left are
refined by Levenberg-Marquardt steps on the log counts. Columns stay inside the range they have in the channel, weights
stay positive, so extrapolation outside the box is tame.

Processors round differently, and counts should not. Merging and damped steps do not amplify rounding: the log counts of
the nodes then differ by less than 1e-9. A sparse non-negative fit over the given nodes, whose columns are all but
linearly dependent, lets them differ by as much as the tolerance. It serves where some of the given nodes are wanted,
and where the fewest nodes of all are sought.
"""

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import nnls

# Rays that nodes are fitted to, and other rays that they are judged by.
_SAMPLES, _FRESH = 400, 2000
# Most Levenberg-Marquardt steps of one fit.
_STEPS = 60
# Most steps of the non-negative fit per node; wide ranges of attenuation take more than the 3 of SciPy.
_NNLS_TURNS = 30
# Longer sets are thinned in blocks of so many neighbours first: the time of a non-negative fit grows with their square.
_LONG, _BLOCK = 2000, 400
# Numbers of nodes that are tried until one meets the tolerance, and most nodes of a set from which nodes are taken
# away: bounds of time.
_TRIED = (*range(1, 17), 20, 24, 29, 35, 42)
_MOST_ELIMINATED = 44
# Times the tolerance by which nodes may err on the way to fewer that are better.
_HOPELESS = 100.0
# Levenberg-Marquardt: damping of the first step, and that at which a fit ends, relative to the diagonal; what is added
# to the diagonal, so that it is never singular. No unit.
_DAMPING, _HIGHEST_DAMPING, _TINY = 1e-3, 1e8, 1e-14


class Nodes(NamedTuple):
    """Energy nodes of one channel.

    Parameters
    ----------
    weights : of the nodes, (K,)
    columns : functions at the nodes, scaled to the box, (K, M)
    """

    weights: Float[np.ndarray, " node"]
    columns: Float[np.ndarray, "node basis"]


class ReducedNodes(NamedTuple):
    """Nodes that replace those of one channel.

    Parameters
    ----------
    weights : of the nodes
    columns : functions at the nodes
    error : worst log error on rays that were not fitted, no unit
    """

    weights: Float[np.ndarray, " few"]
    columns: Float[np.ndarray, "basis few"]
    error: float


def compress_channel(
    weights: Float[np.ndarray, " node"],
    columns: Float[np.ndarray, "basis node"],
    box: Float[np.ndarray, "2 basis"],
    tolerance: float,
    rng: np.random.Generator,
    refine: bool = True,
    thorough: bool = False,
) -> ReducedNodes:
    """Find the fewest nodes whose log counts err by at most `tolerance` in the box.

    Parameters
    ----------
    weights, columns : nodes of one channel
    box : smallest and largest line integrals
    tolerance : largest error of log counts
    rng : source of the sampled line integrals
    refine : whether nodes are merged and moved; without, they are a choice of those handed in, found sooner
    thorough : whether nodes are taken away one by one, each time refining what is left, on more rays: the fewest nodes,
        in seconds per channel where there are four columns

    Returns
    -------
    the new nodes; those handed in, and error 0, where no fewer would do
    """
    scale = np.maximum(np.abs(box).max(axis=0), np.finfo(float).tiny)
    seen = weights > 0
    if np.count_nonzero(seen) < 2:
        return ReducedNodes(weights, columns, 0.0)
    full = Nodes(weights[seen], columns.T[seen] * scale)
    samples = _SAMPLES * len(columns) if thorough else _SAMPLES
    fitted, fresh = (sample_box(box / scale, count, rng) for count in (samples, _FRESH))
    wanted = log_counts(full, fitted), log_counts(full, fresh)
    goal = tolerance / 2 if refine else None
    found = ReducedNodes(weights, columns, 0.0)
    for nodes in (_with_fewer_nodes if thorough else _with_more_nodes)(full, fitted, wanted[0], goal):
        error = float(np.abs(log_counts(nodes, fresh) - wanted[1]).max())
        if error <= tolerance and len(nodes.weights) < len(weights):
            found = ReducedNodes(nodes.weights, (nodes.columns / scale).T, error)
            if not thorough:
                break
        elif thorough and error > _HOPELESS * tolerance:
            break
    return found


def choose_nodes(
    weights: Float[np.ndarray, " node"],
    columns: Float[np.ndarray, "basis node"],
    rays: Float[np.ndarray, "ray basis"],
    tolerance: float,
) -> ReducedNodes:
    """Select some of the given nodes, with new weights, whose log counts err by at most `tolerance` on given rays.

    Parameters
    ----------
    weights, columns : nodes of one channel
    rays : line integrals; every second one is fitted, with the open beam, the others are the judge
    tolerance : largest error of log counts

    Returns
    -------
    the nodes; those handed in, and error 0, where no fewer would do
    """
    full = Nodes(weights, columns.T)
    if len(weights) < 2:
        return ReducedNodes(weights, columns, 0.0)
    fitted, fresh = np.concatenate([np.zeros((1, len(columns))), rays[::2]]), rays[1::2]
    few = _sparse(full, fitted, log_counts(full, fitted))
    error = float(np.abs(log_counts(few, fresh) - log_counts(full, fresh)).max(initial=0.0))
    if error > tolerance or len(few.weights) == len(weights):
        return ReducedNodes(weights, columns, 0.0)
    return ReducedNodes(few.weights, few.columns.T, error)


def sample_box(
    box: Float[np.ndarray, "2 basis"], count: int, rng: np.random.Generator
) -> Float[np.ndarray, "ray basis"]:
    """Sample a box: its corners, and random points denser towards its faces, where polynomial-like fits err most.

    Parameters
    ----------
    box : smallest and largest line integral of each column, (2, M)
    count : number of random points
    rng : source of the random points

    Returns
    -------
    line integrals, (ray, M)
    """
    basis = box.shape[1]
    corners = np.stack(np.meshgrid(*([0.0, 1.0] for _ in range(basis)), indexing="ij"), axis=-1).reshape(-1, basis)
    inside = (1 - np.cos(np.pi * rng.random((count, basis)))) / 2
    return box[0] + np.concatenate([corners, inside]) * (box[1] - box[0])


def log_counts(nodes: Nodes, rays: Float[np.ndarray, "ray basis"]) -> Float[np.ndarray, " ray"]:
    """Compute the logarithm of sum_k w_k exp(-c_k . L).

    Parameters
    ----------
    nodes : weights and columns
    rays : line integrals, (ray, M)

    Returns
    -------
    log counts of each ray
    """
    return _log_shares(nodes, rays)[0]


def _log_shares(
    nodes: Nodes, rays: Float[np.ndarray, "ray basis"]
) -> tuple[Float[np.ndarray, " ray"], Float[np.ndarray, "ray node"]]:
    """Log counts, and each node's share of the counts."""
    exponent = -_attenuation(nodes, rays)
    shift = exponent.max(axis=1, keepdims=True)
    parts = nodes.weights * np.exp(exponent - shift)
    total = parts.sum(axis=1, keepdims=True)
    return (shift + np.log(total))[:, 0], parts / total


def _attenuation(nodes: Nodes, rays: Float[np.ndarray, "ray basis"]) -> Float[np.ndarray, "ray node"]:
    """Exponents c_k . L, without BLAS, whose threads cost more than this product."""
    return np.einsum("rm,km->rk", rays, nodes.columns)


def _with_more_nodes(
    full: Nodes, rays: Float[np.ndarray, "ray basis"], wanted: Float[np.ndarray, " ray"], goal: float | None
) -> Iterator[Nodes]:
    """Yield ever larger sets of refined nodes, where there is a goal, and last a sparse set of the given ones."""
    if goal is not None:
        limits = full.columns.min(axis=0), full.columns.max(axis=0)
        sets = {len(nodes.weights): nodes for nodes in _merged(full, rays, wanted, max(_TRIED))}
        for count in _TRIED:
            if count in sets:
                yield _refined(sets[count], rays, wanted, limits, goal)
    yield _sparse(full, rays, wanted)


def _with_fewer_nodes(
    full: Nodes, rays: Float[np.ndarray, "ray basis"], wanted: Float[np.ndarray, " ray"], goal: float | None
) -> Iterator[Nodes]:
    """Yield the sparse set, then ever smaller ones: two nodes are merged, and all are refined, again and again.

    Node elimination, as in Xiao & Gimbutas 2010, Comput. Math. Appl. 59, 663-676.
    """
    limits = full.columns.min(axis=0), full.columns.max(axis=0)
    nodes = _sparse(full, rays, wanted)
    yield nodes
    while len(nodes.weights) > 1 and goal is not None:
        nodes = next(_merged(nodes, rays, log_counts(nodes, rays), len(nodes.weights) - 1))
        if len(nodes.weights) <= _MOST_ELIMINATED:
            nodes = _refined(nodes, rays, wanted, limits, goal)
            yield nodes


def _merged(
    full: Nodes, rays: Float[np.ndarray, "ray basis"], counts: Float[np.ndarray, " ray"], most: int
) -> Iterator[Nodes]:
    """Yield sets of at most `most` nodes down to one: two neighbours become their mean, again and again.

    Next is the pair whose merging changes the worst log counts least, to second order; `counts` are those of `full`.
    """
    weights, columns = full.weights.copy(), full.columns.copy()
    attenuation = np.ascontiguousarray(_attenuation(full, rays).T)
    shares = weights[:, None] * np.exp(-attenuation - counts) + np.finfo(float).tiny
    kept = list(range(len(weights)))

    def change(i: int, j: int) -> float:
        spread = (attenuation[j] - attenuation[i]) ** 2
        return float((spread * shares[i] * shares[j] / (shares[i] + shares[j])).max())

    changes = [change(i, j) for i, j in pairwise(kept)]
    while True:
        if len(kept) <= most:
            yield Nodes(weights[kept], columns[kept])
        if len(kept) == 1:
            return
        place = int(np.argmin(changes))
        i, j = kept[place], kept.pop(place + 1)
        columns[i] = (weights[i] * columns[i] + weights[j] * columns[j]) / (weights[i] + weights[j])
        weights[i] += weights[j]
        attenuation[i] = np.einsum("rm,m->r", rays, columns[i])
        shares[i] = weights[i] * np.exp(-attenuation[i] - counts) + np.finfo(float).tiny
        del changes[place]
        for pair in {max(place - 1, 0), min(place, len(kept) - 2)} if len(kept) > 1 else ():
            changes[pair] = change(kept[pair], kept[pair + 1])


def _sparse(full: Nodes, rays: Float[np.ndarray, "ray basis"], wanted: Float[np.ndarray, " ray"]) -> Nodes:
    """Few of the given nodes with new weights, by non-negative least squares on the relative counts."""
    if len(full.weights) > _LONG:
        starts = range(0, len(full.weights), _BLOCK)
        blocks = [Nodes(*(part[first : first + _BLOCK] for part in full)) for first in starts]
        thinned = [_selected(block, rays, wanted, np.exp(log_counts(block, rays) - wanted)) for block in blocks]
        full = Nodes(*(np.concatenate(parts) for parts in zip(*thinned, strict=True)))
    return _selected(full, rays, wanted, np.ones(len(rays)))


def _selected(
    nodes: Nodes,
    rays: Float[np.ndarray, "ray basis"],
    scale: Float[np.ndarray, " ray"],
    counts: Float[np.ndarray, " ray"],
) -> Nodes:
    """Some of the nodes with new weights, whose counts are `counts` times the exponential of `scale`.

    All of them where the fit goes round in circles, as it may when nodes are almost equal.
    """
    relative = np.exp(-_attenuation(nodes, rays) - scale[:, None]) * nodes.weights.max()
    try:
        weights = nnls(relative, counts, maxiter=_NNLS_TURNS * len(nodes.weights))[0]
    except RuntimeError:
        return nodes
    chosen = weights > 0
    return Nodes(weights[chosen] * nodes.weights.max(), nodes.columns[chosen])


def _refined(
    nodes: Nodes,
    rays: Float[np.ndarray, "ray basis"],
    wanted: Float[np.ndarray, " ray"],
    limits: tuple[Float[np.ndarray, " basis"], Float[np.ndarray, " basis"]],
    goal: float,
) -> Nodes:
    """Levenberg-Marquardt steps on all weights and columns, until all errors are below `goal`.

    Weights move as logarithms, so that they stay positive; columns stay within `limits`.
    """
    damping = _DAMPING
    log_fit, shares = _log_shares(nodes, rays)
    for _ in range(_STEPS):
        error = wanted - log_fit
        if np.abs(error).max() < goal or damping > _HIGHEST_DAMPING:
            break
        slopes = np.concatenate([shares[:, :, None], -shares[:, :, None] * rays[:, None, :]], axis=2)
        slopes = slopes.reshape(len(rays), -1)
        gradient = np.einsum("rp,r->p", slopes, error)
        blocked = _blocked(nodes, gradient, limits)
        slopes[:, blocked], gradient[blocked] = 0.0, 0.0
        normal = slopes.T @ slopes
        normal[np.diag_indices_from(normal)] *= 1 + damping
        normal[np.diag_indices_from(normal)] += _TINY
        trial = _moved(nodes, np.linalg.solve(normal, gradient), limits)
        trial_fit, trial_shares = _log_shares(trial, rays)
        better = np.sum((wanted - trial_fit) ** 2) < np.sum(error**2)
        damping *= 0.2 if better else 5.0
        if better:
            nodes, log_fit, shares = trial, trial_fit, trial_shares
    return nodes


def _blocked(
    nodes: Nodes,
    gradient: Float[np.ndarray, " parameter"],
    limits: tuple[Float[np.ndarray, " basis"], Float[np.ndarray, " basis"]],
) -> Bool[np.ndarray, " parameter"]:
    """Parameters that stand at a limit and would cross it."""
    node_gradient = gradient.reshape(len(nodes.weights), -1)[:, 1:]
    columns = ((nodes.columns <= limits[0]) & (node_gradient <= 0)) | (
        (nodes.columns >= limits[1]) & (node_gradient >= 0)
    )
    return np.concatenate([np.zeros((len(columns), 1), dtype=bool), columns], axis=1).ravel()


def _moved(
    nodes: Nodes,
    step: Float[np.ndarray, " parameter"],
    limits: tuple[Float[np.ndarray, " basis"], Float[np.ndarray, " basis"]],
) -> Nodes:
    """Nodes after a step of the parameters (log weight, columns), node by node."""
    change = step.reshape(len(nodes.weights), -1)
    weights = nodes.weights * np.exp(np.clip(change[:, 0], -1.0, 1.0))
    return Nodes(weights, np.clip(nodes.columns + change[:, 1:], *limits))
