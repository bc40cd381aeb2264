"""Least squares with a joint total variation and x >= 0, by the primal-dual hybrid gradient method.

The method minimises ``sum_r (A x - L)_r^T F_r (A x - L)_r / 2 + strength TV(x)`` over non-negative x, where L are line
integrals of several bases, F_r their Fisher matrices, or one matrix for all rays, and TV the joint total variation in
the metric of the noise. Steps couple the bases by the mean Fisher matrix, so that nothing depends on the units of the
bases. Dual steps of the rays contain the ramp filter along the rows of the panel, so that high and low frequencies
converge equally fast; where each ray has its own weight, steps are diagonal instead, and many more are needed. With one
component and weights of None this is TV-regularised CT of the log projections of a channel.

References
----------
Chambolle & Pock 2011, doi:10.1007/s10851-010-0251-1; steps: Pock & Chambolle 2011, doi:10.1109/ICCV.2011.6126441;
over-relaxation: Condat 2013, doi:10.1007/s10957-012-0245-9; in CT: Sidky, Jorgensen, Pan 2012,
doi:10.1088/0031-9155/57/10/3065. The duality gap is over a box (ibid. eq. 9).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.fft import irfft, rfft

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.ops.nonnegative_newton import nonnegative_newton_step
from recon.ops.total_variation import ascend, total_variation
from recon.ops.total_variation import gradient as total_variation_gradient
from recon.voxel.iterative.likelihood import forward, transpose
from recon.voxel.iterative.ray_weights import RayWeights, UniformWeights, inner, noise_information
from recon.voxel.method import Images, OnIteration, Report, Volumes, no_callback
from spectra.errors import InputError
from spectra.threads import without_other_pools

GAP_EVERY = 10  # iterations; interval at which the duality gap is computed; chosen by hand, not measured
# no unit; sums of absolute coefficients of differences: two voxels per difference, six differences per voxel
ROW_SUM, COLUMN_SUM = 2.0, 6.0
# iterations; no unit; power method, which approaches a norm from below, and the factor on it; chosen by hand
NORM_ROUNDS, NORM_MARGIN = 10, 1.1
# no unit; dual step of rays that do not meet the grid, large enough that their dual converges in one step
FAR = 1e3
# no unit; bound of the box of the duality gap over the largest coefficient of a basis; chosen by hand, not measured
LARGEST = 2.0

Weights = (
    Float[np.ndarray, "basis basis"] | Float[np.ndarray, "pair view row column"] | Float[np.ndarray, "view row column"]
)


@dataclass(frozen=True)
class PdhgTv:
    """PDHG-TV with its settings.

    The strength was compared by `benchmarks.reconstruction.comparison_methods`
    (`docs/reference/benchmarks/voxel_methods.md`, which also has the steps); the other values were chosen by hand.

    Parameters
    ----------
    iterations : largest number of iterations
    tolerance : duality gap over the objective at which iterations end [no unit]; volumes converge long before, as most
        of the gap is what the box could hold where the dual is not quite feasible
    strength : weight of the total variation; at 1 its bound equals the standard deviation of the gradient of a voxel
    balance : length of dual steps over that of primal ones, in units of noise
    relaxation : over-relaxation of every step [no unit], at least 1 and less than 2
    """

    iterations: int = 400
    tolerance: float = 5e-3
    strength: float = 6.0
    balance: float = 1.0
    relaxation: float = 1.8

    @property
    def name(self) -> str:
        """Name of the method, as in ``--method``."""
        return "pdhg-tv"

    def __post_init__(self) -> None:
        if self.iterations < 1 or self.strength < 0 or self.balance <= 0:
            raise InputError(
                "pdhg-tv iterations must be at least 1, strength not negative and balance positive, "
                f"got {self.iterations}, {self.strength:g} and {self.balance:g}"
            )
        if not 1 <= self.relaxation < 2:
            raise InputError(f"pdhg-tv relaxation must be at least 1 and less than 2, got {self.relaxation:g}")

    @without_other_pools()
    def reconstruct(
        self,
        line_integrals: Images,
        weights: Weights | None,
        geometry: Geometry,
        grid: Grid,
        on_iteration: OnIteration = no_callback,
        start: Volumes | None = None,
    ) -> Volumes:
        """Reconstruct volumes from line integrals; any number of threads gives the same ones.

        Parameters
        ----------
        line_integrals : one image per basis and view [no unit]
        weights : one Fisher matrix (basis, basis) for all rays, or (pair, view, row, column) the upper triangle of each
            ray, row by row; None for the inverse covariance of the noise in the images, and (view, row, column) for
            this times a factor of each ray
        geometry : poses of the views, on any orbit
        grid : the volume to reconstruct
        on_iteration : called after every iteration
        start : initial volumes [1/mm], zeros by default

        Returns
        -------
        volumes of the bases [1/mm]
        """
        if weights is None or weights.shape == line_integrals.shape[1:]:
            shown = noise_information(line_integrals)
            weights = shown if weights is None else np.multiply.outer(shown[np.triu_indices(len(shown))], weights)
        problem = _Problem(line_integrals, np.asarray(weights), geometry, grid, self)
        report = Report(on_iteration, self.iterations)
        volumes = np.zeros((len(line_integrals), *grid.shape), np.float32) if start is None else start
        state = reached = problem.begin(np.array(volumes, np.float32))
        for i in range(self.iterations):
            reached = problem.step(state)
            looked = (i + 1) % GAP_EVERY == 0 or i + 1 == self.iterations
            gap = problem.gap(reached) if looked else None
            report(reached.volumes, gap)
            if gap is not None and gap < self.tolerance:
                break
        return reached.volumes


@dataclass
class _State:
    """Volumes and their projections; duals of the rays and of the differences; gradient at the volumes."""

    volumes: Volumes
    images: Images
    rays: Images
    field: Float[np.ndarray, "axis basis z y x"]
    volume_gradients: Volumes

    def move(self, reached: "_State", relaxation: float) -> None:
        """Over-relax towards the result of a step, in place; the result is feasible, this state need not be."""
        for name, mine in vars(self).items():
            mine[:] = np.float32(1 - relaxation) * mine + np.float32(relaxation) * getattr(reached, name)


class _Problem:
    """Data, step lengths and weights, which all iterations share."""

    def __init__(self, measured: Images, weights: Weights, geometry: Geometry, grid: Grid, settings: PdhgTv) -> None:
        if weights.ndim not in (2, 4):
            raise InputError(
                "weights must be one matrix (basis, basis) or a triangle per ray (pair, view, row, column), "
                f"got shape {weights.shape}"
            )
        self.measured, self.geometry, self.grid = np.asarray(measured, np.float32), geometry, grid
        self.strength, self.relaxation, balance = settings.strength, settings.relaxation, settings.balance
        rows = forward(np.ones((1, *grid.shape), np.float32), geometry, grid)[0]
        size = _gradient_noise(rows, geometry, grid)
        ones = np.ones(grid.shape, np.float32)
        self.radii = settings.strength * ones
        if weights.ndim == 2:
            ramp = _ramp(measured.shape[-1])
            largest = NORM_MARGIN * _filtered_norm(ramp, geometry, grid)
            self.weights = UniformWeights(weights, balance / 2 * ramp)
            self.field_steps = balance / 2 * largest / (ROW_SUM * COLUMN_SUM * size**2) * ones
            voxel_steps = ones / (balance * largest)
        else:
            met = rows > 1e-6 * rows.max()
            self.weights = RayWeights(weights, np.divide(balance, rows, out=np.full_like(rows, FAR), where=met))
            columns = transpose(np.ones((1, *rows.shape), np.float32), geometry, grid)[0]
            self.field_steps = balance / (ROW_SUM * size) * ones
            voxel_steps = 1 / (balance * (columns + COLUMN_SUM * size))
        mean = self.weights.mean
        self.mixing = size * np.linalg.cholesky(mean).T
        self.inverse = np.linalg.inv(mean)[np.triu_indices(len(mean))][:, None, None, None] * voxel_steps

    def begin(self, volumes: Volumes) -> _State:
        """Make the first state."""
        rays = np.zeros_like(self.measured)
        field = np.zeros((3, *volumes.shape), np.float32)
        return _State(volumes, forward(volumes, self.geometry, self.grid), rays, field, np.zeros_like(volumes))

    def step(self, state: _State) -> _State:
        """Do one iteration: move `state` in place, and return the feasible result."""
        new = nonnegative_newton_step(state.volumes, self.inverse, state.volume_gradients)
        images = forward(new, self.geometry, self.grid)
        rays = self.weights.proximal(state.rays, 2 * images - state.images, self.measured)
        field = state.field.copy()
        ascend(field, 2 * new - state.volumes, self.mixing, self.grid, self.field_steps, self.radii)
        volume_gradients = transpose(rays, self.geometry, self.grid) + total_variation_gradient(
            field, self.mixing, self.grid
        )
        reached = _State(new, images, rays, field, volume_gradients)
        state.move(reached, self.relaxation)
        return reached

    def gap(self, state: _State) -> float:
        """Compute the primal minus the dual objective, over the primal one."""
        primal = self.weights.half_square(state.images - self.measured)
        primal += self.strength * total_variation(state.volumes, self.mixing, self.grid)
        dual = -self.weights.half_inverse_square(state.rays) - inner(state.rays, self.measured)
        highest = LARGEST * state.volumes.max(axis=(1, 2, 3))
        dual += float(highest @ np.minimum(state.volume_gradients, 0).sum(axis=(1, 2, 3), dtype=np.float64))
        return (primal - dual) / max(primal, 1e-300)


def _gradient_noise(rows: Float[np.ndarray, "view row column"], geometry: Geometry, grid: Grid) -> float:
    """Standard deviation of the gradient of a voxel for rays with noise of standard deviation 1, from one draw."""
    draws = np.random.default_rng(0).standard_normal((1, *rows.shape), np.float32)
    seen = transpose(draws, geometry, grid)
    seen = seen[seen != 0]
    return float(np.sqrt(np.mean(seen**2))) if seen.size else 1.0


def _ramp(columns: int) -> Float[np.ndarray, " frequency"]:
    """Ramp along rows, 1 at the highest frequency; frequency 0 has the value of the lowest other one."""
    return np.maximum(np.arange(columns // 2 + 1), 1.0) / max(columns // 2, 1)


def _filtered_norm(ramp: Float[np.ndarray, " frequency"], geometry: Geometry, grid: Grid) -> float:
    """Largest eigenvalue of projection, ramp filter and transpose in sequence, by the power method."""
    volume = np.random.default_rng(0).standard_normal((1, *grid.shape), np.float32)
    size = 1.0
    for _ in range(NORM_ROUNDS):
        images = forward(volume, geometry, grid)
        filtered = irfft(np.asarray(rfft(images, axis=-1)) * ramp, n=images.shape[-1], axis=-1)
        volume = transpose(np.asarray(filtered, dtype=np.float32), geometry, grid)
        size = max(float(np.linalg.norm(volume)), 1e-30)
        volume /= np.float32(size)
    return size
