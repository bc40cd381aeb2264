"""Gauss-Newton steps for the pose of the panel at one resolution, the volume projected out.

Log projections p and a change t of the panel obey p = A(t) x, with a volume x that nobody knows. With Q the projection
that takes away what volumes explain (`recon.alignment.projected_out`), and J the derivatives of A(t) x in t, a step is

    dt = (J' Q' W Q J)^-1 J' Q' W Q p.

Q J says how well the data determine t without knowing x: an error that a change of the volume explains as well has
Q J = 0, and the more of it a volume explains, the less certain it is.
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
CONVERGED = 0.005  # of a block; steps below end a level
SAME_SLOPES = 0.05  # of a block; the derivatives are not computed anew after smaller steps
# Shifts of the voxels, whose mean is the estimate: where an edge of the object lies between voxels moves it a little.
PHASES = (0.0, 0.25, 0.5, 0.75)
RUNS = 12  # runs of neighbouring views, whose scatter gives an uncertainty


@dataclass(frozen=True, eq=False)
class Estimate:
    """Change of the panel at one resolution.

    Parameters
    ----------
    change : columns, turn
    free : places of those that were estimated
    noise : covariance by the noise of counts
    scatter : covariance by how much runs of views differ
    voxels : covariance by how much estimates on shifted voxels differ
    """

    change: Change
    free: tuple[int, ...]
    noise: Float[np.ndarray, "free free"]
    scatter: Float[np.ndarray, "free free"]
    voxels: Float[np.ndarray, "free free"]

    @property
    def uncertainty(self) -> Float[np.ndarray, " free"]:
        """Standard uncertainty of the free numbers."""
        return np.sqrt(np.diag(self.noise + self.scatter + self.voxels))


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
    weights = level.data[1]
    rest = _rest(level, change)
    return float(np.sum(weights * rest**2, dtype=np.float64) / np.count_nonzero(weights))


def _rest(level: Level, change: Change, phase: float = 0.0) -> Float[np.ndarray, "view row column"]:
    """Compute what volumes do not explain of the data after a change of the panel."""
    logs, weights = level.data
    return explain(logs[None], level.pair(change, phase), weights, ITERATIONS).rest[0]


def _covariance_of_phases(steps: Float[np.ndarray, "phase free"]) -> Float[np.ndarray, "free free"]:
    """Covariance of the mean over the phases, by the two pairs of grids that are half a voxel apart."""
    half = (steps[::2].mean(axis=0) - steps[1::2].mean(axis=0)) / 2
    return np.outer(half, half)


def gauss_newton(level: Level, change: Change, free: tuple[int, ...]) -> Estimate:
    """Take Gauss-Newton steps until they are small.

    Parameters
    ----------
    level : the scan
    change : where to start
    free : places of the numbers to estimate

    Returns
    -------
    the estimate
    """
    (logs, weights), some = level.data, list(free)
    block = 4 * steps_of(level.full.geometry, level.factor)[some]  # what moves the edge of the panel by a block
    system: _System | None = None
    moved = np.inf
    for _ in range(MOST_STEPS):
        found = explain(logs[None], level.pair(change), weights, ITERATIONS)
        if system is None or moved > SAME_SLOPES:
            system = _System.of(level, found.volumes, change, free)
        step = system.step(found.rest[0])
        change = change.copy()
        change[some] += step
        moved = float(np.max(np.abs(step) / block))
        if moved < CONVERGED:
            break
    assert system is not None  # there is at least one step
    rests = [_rest(level, change, phase) for phase in PHASES]
    steps = np.stack([system.step(rest) for rest in rests])
    change = change.copy()
    change[some] += steps.mean(axis=0)
    return Estimate(change, free, system.noise, system.scatter(rests[0]), _covariance_of_phases(steps))


@dataclass(frozen=True, eq=False)
class _System:
    """Normal equations of a step: derivatives without what volumes explain, weights, inverse, covariance by noise."""

    derivatives: Float[np.ndarray, "free view row column"]
    weights: Float[np.ndarray, "view row column"]
    inverse: Float[np.ndarray, "free free"]
    noise: Float[np.ndarray, "free free"]

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
        return cls(left, weights, inverse, inverse @ by_noise @ inverse)

    def slopes(self, rest: Float[np.ndarray, "view row column"]) -> Float[np.ndarray, "free view"]:
        """Slope of the squared misfit in each free number, view by view."""
        return np.einsum("fvrc,vrc->fv", self.derivatives, self.weights * rest, dtype=np.float64)

    def step(self, rest: Float[np.ndarray, "view row column"]) -> Float[np.ndarray, " free"]:
        """Gauss-Newton step of the free numbers."""
        return self.inverse @ self.slopes(rest).sum(axis=1)

    def scatter(self, rest: Float[np.ndarray, "view row column"]) -> Float[np.ndarray, "free free"]:
        """Covariance of a step by the scatter of runs of views about their mean (the sandwich estimate)."""
        by_view = self.slopes(rest)
        runs = np.array_split(by_view, min(RUNS, by_view.shape[1]), axis=1)
        sums = np.stack([run.sum(axis=1) for run in runs], axis=1)
        sums -= sums.mean(axis=1, keepdims=True)
        return self.inverse @ (sums @ sums.T) @ self.inverse


def _products(
    images: Float[np.ndarray, "free view row column"], weights: Float[np.ndarray, "view row column"]
) -> Float[np.ndarray, "free free"]:
    """Weighted inner products of images."""
    return np.array([[np.sum(weights * a * b, dtype=np.float64) for b in images] for a in images])
