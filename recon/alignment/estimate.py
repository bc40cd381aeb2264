"""Gauss-Newton steps for the pose of the panel at one resolution, the volume projected out.

Log projections p and a change t of the panel obey p = A(t) x, with a volume x that nobody knows. With Q the projection
that takes away what volumes explain (`recon.alignment.projected_out`), and J the derivatives of A(t) x in t, a step is

    dt = (J' Q' W Q J)^-1 J' Q' W Q p.

Q J says how well the data determine t without knowing x: an error that a change of the volume explains as well, such
as a shift along the rows in a parallel beam, has Q J = 0.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from recon.alignment.levels import Level
from recon.alignment.log_projections import LEAST_COUNTS
from recon.alignment.panel_errors import Change, steps_of
from recon.alignment.projected_out import explain

ITERATIONS = 20  # steps of the inner solver; chosen by hand
MOST_STEPS = 8  # Gauss-Newton steps of a level
CONVERGED = 0.02  # of a block; steps below end a level that a finer one follows
FINISHED = 0.1  # of the uncertainty; steps below end the last level
RUNS = 12  # runs of neighbouring views, whose scatter gives an uncertainty


@dataclass(frozen=True, eq=False)
class Estimate:
    """Change of the panel at one resolution.

    Parameters
    ----------
    change : columns, rows, turn
    free : places of those that were estimated
    noise : covariance by the noise of counts
    scatter : covariance by how much runs of views differ
    seen : part of the squared derivative in each free number that no volume and no other number explains
    misfit : mean weighted squared difference of data and reprojections
    """

    change: Change
    free: tuple[int, ...]
    noise: Float[np.ndarray, "free free"]
    scatter: Float[np.ndarray, "free free"]
    seen: Float[np.ndarray, " free"]
    misfit: float

    @property
    def uncertainty(self) -> Float[np.ndarray, " free"]:
        """Standard uncertainty of the free numbers by noise and by the scatter of views."""
        return np.sqrt(np.diag(self.noise) + np.diag(self.scatter))


def misfit(level: Level, change: Change) -> float:
    """Compute how badly volumes explain the data after a change of the panel.

    Parameters
    ----------
    level : the scan
    change : of the panel

    Returns
    -------
    mean weighted squared difference
    """
    logs, weights = level.data
    rest = explain(logs[None], level.pair(change), weights, ITERATIONS).rest[0]
    return float(np.sum(weights * rest**2, dtype=np.float64) / np.count_nonzero(weights))


def gauss_newton(level: Level, change: Change, free: tuple[int, ...], last: bool) -> Estimate:
    """Take Gauss-Newton steps until they are small.

    Parameters
    ----------
    level : the scan
    change : where to start
    free : places of the numbers to estimate
    last : whether no finer level follows, so that steps must be small against the uncertainty

    Returns
    -------
    the estimate
    """
    logs, weights = level.data
    system = None
    for _ in range(MOST_STEPS):
        pair = level.pair(change)
        found = explain(logs[None], pair, weights, ITERATIONS)
        if system is None or not last:
            system = _System.of(level, found.volumes, change, free)
        by_view = system.slopes(weights * found.rest[0])
        step = system.inverse @ by_view.sum(axis=1)
        change = change.copy()
        change[list(free)] += step
        scatter = system.scatter(by_view)
        in_blocks = np.abs(step) / (4 * steps_of(level.full.geometry, level.factor)[list(free)])
        finished = np.abs(step) <= FINISHED * np.sqrt(np.diag(system.noise) + np.diag(scatter))
        if finished.all() or (not last and in_blocks.max() < CONVERGED):
            break
    size = float(np.sum(weights * found.rest[0] ** 2, dtype=np.float64) / max(int(np.count_nonzero(weights)), 1))
    return Estimate(change, free, system.noise, scatter, system.seen, size)


@dataclass(frozen=True, eq=False)
class _System:
    """Normal equations of a step: derivatives without what volumes explain, and what follows from them."""

    derivatives: Float[np.ndarray, "free view row column"]
    inverse: Float[np.ndarray, "free free"]
    noise: Float[np.ndarray, "free free"]
    seen: Float[np.ndarray, " free"]

    @classmethod
    def of(
        cls, level: Level, volumes: Float[np.ndarray, "1 z y x"], change: Change, free: tuple[int, ...]
    ) -> "_System":
        """Central differences of the projections of a volume in each free number, and their normal equations."""
        steps, found = steps_of(level.full.geometry, level.factor), []
        for place in free:
            step = np.zeros_like(change)
            step[place] = steps[place]
            after, before = (level.pair(change + sign * step).project(volumes)[0] for sign in (1, -1))
            found.append((after - before) / (2 * steps[place]))
        slopes, weights = np.stack(found).astype(np.float32), level.data[1]
        left = explain(slopes, level.pair(change), weights, ITERATIONS).rest
        inverse = np.linalg.pinv(_products(left, weights), hermitian=True)
        by_noise = _products(left, weights**2 / np.maximum(level.blocks.counts, LEAST_COUNTS))
        whole = np.diag(_products(slopes, weights)) * np.diag(inverse)
        seen = np.divide(1.0, whole, out=np.zeros_like(whole), where=whole > 0)
        return cls(left, inverse, inverse @ by_noise @ inverse, seen)

    def slopes(self, rest: Float[np.ndarray, "view row column"]) -> Float[np.ndarray, "free view"]:
        """Slope of the squared misfit in each free number, view by view."""
        return np.einsum("fvrc,vrc->fv", self.derivatives, rest, dtype=np.float64)

    def scatter(self, by_view: Float[np.ndarray, "free view"]) -> Float[np.ndarray, "free free"]:
        """Covariance of a step by the scatter of runs of views about their mean (the sandwich estimate)."""
        runs = np.array_split(by_view, min(RUNS, by_view.shape[1]), axis=1)
        sums = np.stack([run.sum(axis=1) for run in runs], axis=1)
        sums -= sums.mean(axis=1, keepdims=True)
        return self.inverse @ (sums @ sums.T) @ self.inverse


def _products(
    images: Float[np.ndarray, "free view row column"], weights: Float[np.ndarray, "view row column"]
) -> Float[np.ndarray, "free free"]:
    """Weighted inner products of images."""
    return np.array([[np.sum(weights * a * b, dtype=np.float64) for b in images] for a in images])
