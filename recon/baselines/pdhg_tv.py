"""Least squares with a joint total variation and x >= 0, by the primal-dual hybrid gradient method.

Minimises ``sum_r (A x - L)_r^T F_r (A x - L)_r / 2 + strength TV(x)`` over non-negative x, where L are line integrals
of several bases, F_r their Fisher matrices, or one matrix for all rays, and TV the joint total variation in the metric
of the noise. Steps are diagonal in voxels and rays and mix the bases as the mean Fisher matrix does, so nothing depends
on their units. With one component and weights of None this is TV-regularised CT of a channel's log projections.

References
----------
Chambolle & Pock 2011, doi:10.1007/s10851-010-0251-1; steps: Pock & Chambolle 2011, doi:10.1109/ICCV.2011.6126441; in
CT: Sidky, Jorgensen, Pan 2012, doi:10.1088/0031-9155/57/10/3065. The duality gap is over a box (ibid. eq. 9).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from phantomgen.geometry import Geometry
from phantomgen.grid import Grid
from recon.baselines.method import Iteration, Report, unwatched
from recon.baselines.ray_weights import RayWeights, noise_information
from recon.baselines.voxel_likelihood import forward, transpose
from recon.ops.positive_step import positive_step
from recon.ops.total_variation import ascend, pull, total_variation
from spectra.errors import InputError
from spectra.threads import without_other_pools

GAP_EVERY = 10  # iterations between two looks at the duality gap
ROW_SUM, COLUMN_SUM = 2.0, 6.0  # of absolute differences: each has two voxels, each voxel six
LARGEST = 2.0  # the box of the duality gap, over the largest coefficient of a basis

Volumes = Float[np.ndarray, "basis z y x"]
Images = Float[np.ndarray, "basis view row column"]
Weights = (
    Float[np.ndarray, "basis basis"] | Float[np.ndarray, "pair view row column"] | Float[np.ndarray, "view row column"]
)


@dataclass(frozen=True)
class PdhgTv:
    """PDHG-TV with its settings.

    Parameters
    ----------
    iterations : at most
    tolerance : duality gap, over the objective, at which it is done
    strength : weight of the total variation; at 1 the noise of a voxel's gradient is as large as its bound
    balance : length of dual steps over that of primal ones, in units of noise
    """

    iterations: int = 100
    tolerance: float = 1e-4
    strength: float = 2.0
    balance: float = 0.3

    @property
    def name(self) -> str:
        """What ``--method`` calls it."""
        return "pdhg-tv"

    def __post_init__(self) -> None:
        if self.iterations < 1 or self.strength < 0 or self.balance <= 0:
            raise InputError(
                "pdhg-tv iterations must be at least 1, strength not negative and balance positive, "
                f"got {self.iterations}, {self.strength:g} and {self.balance:g}"
            )

    @without_other_pools()
    def reconstruct(
        self,
        line_integrals: Images,
        weights: Weights | None,
        geometry: Geometry,
        grid: Grid,
        on_iteration: Callable[[Iteration], None] = unwatched,
        start: Volumes | None = None,
    ) -> Volumes:
        """Volumes [1/mm]; any number of threads gives the same ones.

        Parameters
        ----------
        line_integrals : of every basis [no unit]
        weights : Fisher matrix of all rays, or of each, the upper triangle row by row; None for that of the noise
            which the images show, and (view, row, column) for this times a factor of each ray
        geometry : poses of the views, on any orbit
        grid : voxels to reconstruct
        on_iteration : called after every iteration
        start : first guess, default zeros
        """
        if weights is None or weights.shape == line_integrals.shape[1:]:
            shown = noise_information(line_integrals)
            weights = shown if weights is None else np.multiply.outer(shown[np.triu_indices(len(shown))], weights)
        problem = _Problem(line_integrals, weights, geometry, grid, self.strength, self.balance)
        report = Report(on_iteration, self.iterations)
        volumes = np.zeros((len(line_integrals), *grid.shape), np.float32) if start is None else start
        state = problem.begin(np.asarray(volumes, np.float32))
        for i in range(self.iterations):
            problem.step(state)
            looked = (i + 1) % GAP_EVERY == 0 or i + 1 == self.iterations
            gap = problem.gap(state) if looked else None
            report(state.volumes, gap)
            if gap is not None and gap < self.tolerance:
                break
        return state.volumes


@dataclass
class _State:
    """Volumes and their projections; duals of the rays and of the differences; what these pull at the volumes."""

    volumes: Volumes
    images: Images
    rays: Images
    field: Float[np.ndarray, "axis basis z y x"]
    pulls: Volumes


class _Problem:
    """Everything that stays the same from one iteration to the next."""

    def __init__(
        self, measured: Images, weights: Weights, geometry: Geometry, grid: Grid, strength: float, balance: float
    ) -> None:
        self.measured, self.geometry, self.grid = np.asarray(measured, np.float32), geometry, grid
        self.strength = strength
        rows = forward(np.ones((1, *grid.shape), np.float32), geometry, grid)[0]
        columns = transpose(np.ones((1, *rows.shape), np.float32), geometry, grid)[0]
        size = _gradient_noise(rows, geometry, grid)
        self.ray_steps = np.divide(balance, rows, out=np.zeros_like(rows), where=rows > 1e-6 * rows.max())
        self.weights = RayWeights(weights, self.ray_steps)
        mean = self.weights.mean
        self.mixing = size * np.linalg.cholesky(mean).T
        ones = np.ones(grid.shape, np.float32)
        self.field_steps = balance / (ROW_SUM * size) * ones
        voxel_steps = 1 / (balance * (columns + COLUMN_SUM * size))
        upper = np.triu_indices(len(mean))
        self.inverse = np.linalg.inv(mean)[upper][:, None, None, None] * voxel_steps

    def begin(self, volumes: Volumes) -> _State:
        """First state."""
        rays = np.zeros_like(self.measured)
        field = np.zeros((3, *volumes.shape), np.float32)
        return _State(volumes, forward(volumes, self.geometry, self.grid), rays, field, np.zeros_like(volumes))

    def step(self, state: _State) -> None:
        """One iteration."""
        new = positive_step(state.volumes, self.inverse, state.pulls)
        images = forward(new, self.geometry, self.grid)
        state.rays = self.weights.toward(state.rays, 2 * images - state.images, self.measured)
        ascend(state.field, 2 * new - state.volumes, self.mixing, self.grid, self.field_steps, self.strength)
        state.volumes, state.images = new, images
        state.pulls = transpose(state.rays, self.geometry, self.grid) + pull(state.field, self.mixing, self.grid)

    def gap(self, state: _State) -> float:
        """Primal minus dual objective, over the primal one."""
        primal = self.weights.half_square(state.images - self.measured)
        primal += self.strength * total_variation(state.volumes, self.mixing, self.grid)
        dual = -self.weights.half_inverse_square(state.rays) - float(np.vdot(state.rays, self.measured))
        highest = LARGEST * state.volumes.max(axis=(1, 2, 3))
        dual += float(highest @ np.minimum(state.pulls, 0).sum(axis=(1, 2, 3), dtype=np.float64))
        return (primal - dual) / max(primal, 1e-300)


def _gradient_noise(rows: Float[np.ndarray, "view row column"], geometry: Geometry, grid: Grid) -> float:
    """Root mean square of the noise of a voxel's gradient where that of the rays is 1, from one draw."""
    draws = np.random.default_rng(0).standard_normal((1, *rows.shape), np.float32)
    seen = transpose(draws, geometry, grid)
    seen = seen[seen != 0]
    return float(np.sqrt(np.mean(seen**2))) if seen.size else 1.0
