"""One-step reconstruction of voxels: from counts to basis volumes without line integrals in between.

The minimum of half the deviance of all counts, all channels at once, plus a joint total variation, over non-negative
coefficients. Each step is a separable quadratic surrogate of the likelihood of some of the views (ordered subsets),
with blocks that mix the bases, and Nesterov's momentum, which restarts where it points backwards. The total variation
and x >= 0 are met in the metric of the surrogate, by a few steps on the dual that begin where the last ones ended.
Coarse voxels come first, with pixels summed to match, so that no other reconstruction is needed to start from; their
edges are made steeper before finer voxels take over, which spares those most of their passes. Rays close to each other
get the same say, as voxels cannot tell them apart (`recon.data.partial_volume`), and the total variation has less of it
where rays know little, as behind thick metal; what comes out there are means over voxels (`means_in_metal`). Memory
grows with voxels, not with views: some 40 volumes of 32-bit numbers for three bases.

References
----------
Surrogates: Weidinger et al. 2016, doi:10.1155/2016/5871604; Mechlem et al. 2018, doi:10.1109/TMI.2017.2726687. Momentum
with subsets: Kim, Ramani, Fessler 2015, doi:10.1109/TMI.2014.2350962. Restart: O'Donoghue & Candes 2015,
doi:10.1007/s10208-013-9150-3.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, sqrt

import numpy as np
from jaxtyping import Float
from scipy.ndimage import convolve1d, minimum_filter

from phantomgen.geometry.voxel_grid import Grid
from recon.data.measurements import Measurements, matching_bin
from recon.data.view_subsets import every, kinds_of, parts_of
from recon.data.volume_edges import metal_without_agents, over_metal
from recon.ops.nonnegative_newton import as_matrices, inverse_blocks, nonnegative_newton_step
from recon.ops.total_variation import ascend, neighbour_sums
from recon.ops.total_variation import gradient as total_variation_gradient
from recon.voxel.iterative.likelihood import curvature, deviance_and_gradient
from recon.voxel.iterative.multigrid import coarser, occupied, resampled, sharpened
from recon.voxel.method import Iteration, Report, unwatched
from spectra.errors import InputError
from spectra.threads import without_other_pools

CURVATURE_STEP = 3.236  # views of a kind between two that give the curvature
ASTRAY = 1.5  # times the least deviance of a pass
LITTLE = 0.5  # of the typical curvature; below it the total variation counts less
FADING = 0.7  # power of the curvature by which it does; noise goes by 0.5, information by 1
RENEWED = 3  # passes of a level after which the curvature is computed anew
MANY = 100  # views; the more there are beyond, the more subsets there are, and the fewer passes
FEWEST = 2  # passes, however many views there are
FEW = 75  # views; of fewer, there are more passes, by the root of what is missing: noise comes in with every pass
NO_AGENT = 0.1  # precision of K edges at 0, over their curvature, in metal twice as dense as the least dense metal
UNMET = 1e-4  # of the mean curvature; voxels that no ray meets stay as they are, those in thick metal have little more
_MEAN = (1 / 8, 3 / 4, 1 / 8)  # of a piecewise linear function over a voxel, by its values in the centres

Volumes = Float[np.ndarray, "basis z y x"]


@dataclass(frozen=True)
class OneStep:
    """One-step reconstruction with its settings.

    Parameters
    ----------
    levels : voxels of each level in voxels of the grid asked for, and passes over the views, of which more than 100
        take fewer, and fewer than 75 more; a start of one's own wants the level 1 alone
    pixel : largest pixel as seen at the isocentre, in voxels of the level; finer ones are summed
    subsets : parts of the views that take turns, of more than 100 views more; of fewer, more than 6 need not converge
    dispersion : relative model error added to the Poisson variance
    strength : weight of the total variation; at 1 the noise of a voxel's gradient is as large as its bound
    dual_steps : steps towards the least total variation for every step of the likelihood
    momentum : whether steps gather speed
    """

    levels: tuple[tuple[int, int], ...] = ((4, 8), (2, 8), (1, 16))
    pixel: float = 1.0
    subsets: int = 5
    dispersion: float = 0.03
    strength: float = 1.5
    dual_steps: int = 3
    momentum: bool = True

    @property
    def name(self) -> str:
        """What ``--method`` calls it."""
        return "one-step"

    def __post_init__(self) -> None:
        if not self.levels or min(min(level) for level in self.levels) < 1:
            raise InputError(f"one-step levels must be pairs of whole numbers from 1 on, got {self.levels}")
        if min(self.subsets, self.dual_steps) < 1 or self.pixel <= 0:
            raise InputError(
                "one-step subsets and dual_steps must be at least 1 and pixel positive, "
                f"got {self.subsets}, {self.dual_steps} and {self.pixel:g}"
            )
        if min(self.dispersion, self.strength) < 0:
            raise InputError(
                f"one-step dispersion and strength must not be negative, got {self.dispersion:g} and {self.strength:g}"
            )

    @without_other_pools()
    def reconstruct_counts(
        self,
        measurements: Measurements,
        grid: Grid,
        on_iteration: Callable[[Iteration], None] = unwatched,
        start: Volumes | None = None,
    ) -> Volumes:
        """Volumes [1/mm] of every basis; any number of threads gives the same ones.

        Parameters
        ----------
        measurements : views to use, unbinned, whatever their orbit
        grid : voxels to reconstruct
        on_iteration : called after every pass over the views
        start : first guess on `grid`, default zeros; what lies outside of the box that it fills stays empty
        """
        volumes, here = np.zeros((len(measurements.basis_names), *grid.shape), np.float32), grid
        if start is not None:
            volumes = start.astype(np.float32)
        levels = [(factor, _passes(passes, len(measurements))) for factor, passes in self.levels]
        report = Report(on_iteration, sum(passes for _, passes in levels))
        for factor, passes in levels:
            level = coarser(grid, factor)
            finer = min(level.spacing) < min(here.spacing)
            volumes, here = resampled(volumes, here, level), level
            if finer:
                volumes = sharpened(volumes)
            data = measurements.binned(matching_bin(measurements.geometry, self.pixel * min(level.spacing)))
            data = data.weighted(self.dispersion)
            volumes = _descend(volumes, data, level, self, passes, report)
        return _shown(resampled(volumes, here, grid), self)


def means_in_metal(volumes: Volumes) -> Volumes:
    """Volumes with means over voxels in metal, where the values that fit the rays are something else.

    The projector interpolates between the centres of voxels. The mean of what it sees over a voxel is 3/4 of its own
    value and 1/8 of that of either neighbour, along each axis. Elsewhere a total variation decides between values that
    fit as well, and takes those of even pieces; the edges of these lie on faces of voxels, and their values are means.
    In metal, where it counts little, values overshoot and those beside them fall too low.
    """
    over = over_metal(volumes)
    if over.max(initial=1) <= 1:
        return volumes
    means = volumes
    for axis in (1, 2, 3):
        means = convolve1d(means, _MEAN, axis=axis, mode="nearest")
    return volumes + (1 - 1 / over**2).astype(np.float32) * (means - volumes)


def _descend(
    volumes: Volumes, data: Measurements, grid: Grid, settings: OneStep, passes: int, report: Report
) -> Volumes:
    """Improve volumes on one grid, where they hold something; where subsets lead astray, fewer of them go on."""
    box = occupied(volumes)
    inner, whole = grid.part(box), np.zeros_like(volumes)
    counts = max(int(np.count_nonzero(data.gains, axis=(1, 2)) @ np.count_nonzero(data.exposure, axis=0)), 1)
    first = np.ascontiguousarray(volumes[:, *box])
    walk = _Walk(first, np.zeros((3, *first.shape), np.float32))
    more, best, least, metric = _more_than_many(data), first, np.inf, None
    parts = min(round(more * settings.subsets), len(data))
    for i in range(passes):
        if metric is None or i == ceil(RENEWED / more):
            metric = _metric(walk.volumes, data, inner, settings)
        deviance = _pass(walk, data, inner, settings, metric, parts)
        if not deviance < ASTRAY * least and parts > 1:
            walk = _Walk(best, np.zeros_like(walk.field))
            parts = parts // 2 | 1
        elif deviance < least:
            best, least = walk.volumes, deviance
        whole[:, *box] = _shown(walk.volumes, settings)
        report(whole, deviance / counts, grid)
    whole[:, *box] = walk.volumes
    return whole


def _passes(asked: int, views: int) -> int:
    """As many as are asked for, fewer over many views and more over few."""
    if views < FEW:
        return ceil(asked * sqrt(FEW / views))
    return max(ceil(asked * min(MANY / views, 1.0)), min(asked, FEWEST))


def _more_than_many(data: Measurements) -> float:
    """Views over `MANY`, at least 1: subsets are as many times more and passes fewer, so that steps are as many."""
    return max(len(data) / MANY, 1.0)


def _shown(volumes: Volumes, settings: OneStep) -> Volumes:
    """What comes out; without a total variation, values are left as they fit the rays, everywhere alike."""
    return means_in_metal(volumes) if settings.strength else volumes


@dataclass
class _Walk:
    """Where a descent stands: volumes, dual of the total variation, point of the next step, speed."""

    volumes: Volumes
    field: Float[np.ndarray, "axis basis z y x"]
    point: Volumes | None = None
    speed: float = 1.0


def _pass(walk: _Walk, data: Measurements, grid: Grid, settings: OneStep, metric: "_Metric", parts: int) -> float:
    """Every view once, in so many parts; returns the sum of the deviances that were met."""
    total, agreement = 0.0, 0.0
    subsets = parts_of(kinds_of(data.exposure), parts)
    for first in _order(len(subsets)):
        some = data[subsets[first]]
        point = walk.volumes if walk.point is None else walk.point
        deviance, gradient = deviance_and_gradient(point, some, grid, settings.dispersion)
        gradient *= np.float32(len(data) / len(some))
        new = _proximal(point, gradient, walk.field, metric, grid, settings)
        step = new - walk.volumes
        agreement += _inner(point - new, step, metric.mixing)
        faster = (1 + np.sqrt(1 + 4 * walk.speed**2)) / 2 if settings.momentum else 1.0
        walk.point = new + np.float32((walk.speed - 1) / faster) * step
        walk.volumes, walk.speed = new, faster
        total += deviance
    if agreement > 0:
        walk.point, walk.speed = None, 1.0
    return total


@dataclass(frozen=True)
class _Metric:
    """Inverse blocks of the surrogate; W of the total variation; steps of its dual, and its bounds; precision at 0."""

    inverse: Float[np.ndarray, "pair z y x"]
    mixing: Float[np.ndarray, "basis basis"]
    steps: Float[np.ndarray, "z y x"]
    bounds: Float[np.ndarray, "z y x"]
    empty: Volumes | None = None


def _metric(volumes: Volumes, data: Measurements, grid: Grid, settings: OneStep) -> _Metric:
    """The metric at volumes.

    Metal holds no contrast agent, but no mixture of bases attenuates as metal does, and what is missing looks like a K
    edge. So K edges have a prior at 0 there, the more the denser the metal.
    """
    some = data[every(kinds_of(data.exposure), CURVATURE_STEP)]
    share = len(data) / len(some)
    blocks, covariance = curvature(volumes, some, grid, settings.dispersion)
    upper = np.triu_indices(len(volumes))
    own = blocks[upper[0] == upper[1]]
    diagonal = share * own.mean(axis=(1, 2, 3))
    blocks *= np.float32(share)
    edges, over = metal_without_agents(volumes, data.basis_names)
    empty = None
    if over.max(initial=1) > 1:
        empty = edges[:, None, None, None] * (blocks[upper[0] == upper[1]] * np.float32(NO_AGENT) * (over - 1))
        empty = empty.astype(np.float32)
        blocks[upper[0] == upper[1]] += empty
    inverse = inverse_blocks(blocks, UNMET * diagonal + 1e-30)
    ridge = (1e-12 * np.trace(covariance) + 1e-30) * np.eye(len(volumes))
    mixing = np.sqrt(share) * np.linalg.cholesky(covariance + ridge).T
    bounds = np.float32(settings.strength) * _statistical_weights(own, volumes.sum(axis=0))
    return _Metric(inverse, mixing, 1 / neighbour_sums(_largest(inverse, mixing), grid), bounds, empty)


def _statistical_weights(
    curvatures: Float[np.ndarray, "basis z y x"], density: Float[np.ndarray, "z y x"]
) -> Float[np.ndarray, "z y x"]:
    """What differences of a voxel count in the total variation: 1, and less where curvature is far below the typical.

    What a total variation takes off an edge is its weight over what rays know. One that counts as much where they know
    little would rule there: in thick metal it would exchange photoelectric absorption for Compton scattering until
    their edges were least. In proportion to what they know, it would leave edges in metal as soft as rays see them. So
    it counts by a power in between. Of a voxel and its neighbours, the least counts.
    """
    weights = density / density.sum() if density.any() else np.full_like(density, 1 / density.size)
    typical = np.einsum("bzyx,zyx->b", curvatures, weights)
    relative = (curvatures / np.maximum(typical, 1e-30)[:, None, None, None]).mean(axis=0)
    return minimum_filter(np.minimum((relative / LITTLE) ** FADING, 1), 3)


def _largest(inverse: Float[np.ndarray, "pair z y x"], mixing: Float[np.ndarray, "basis basis"]) -> np.ndarray:
    """Bound of the eigenvalues of W H^-1 W^T in every voxel, the Frobenius norm."""
    out = np.empty(inverse.shape[1:], np.float32)
    for z in range(len(out)):
        mixed = mixing @ as_matrices(inverse[:, z]) @ mixing.T
        out[z] = np.sqrt(np.square(mixed).sum(axis=(-2, -1)))
    return out


def _proximal(
    point: Volumes,
    gradient: Volumes,
    field: Float[np.ndarray, "axis basis z y x"],
    metric: _Metric,
    grid: Grid,
    settings: OneStep,
) -> Volumes:
    """Minimum of the surrogate plus total variation over x >= 0, nearly; `field`, the dual, is improved in place."""
    if metric.empty is not None:
        gradient = gradient + metric.empty * point
    if settings.strength == 0:
        return nonnegative_newton_step(point, metric.inverse, gradient)
    new = nonnegative_newton_step(
        point, metric.inverse, gradient + total_variation_gradient(field, metric.mixing, grid)
    )
    for _ in range(settings.dual_steps):
        ascend(field, new, metric.mixing, grid, metric.steps, metric.bounds)
        new = nonnegative_newton_step(
            point, metric.inverse, gradient + total_variation_gradient(field, metric.mixing, grid)
        )
    return new


def _inner(one: Volumes, other: Volumes, mixing: Float[np.ndarray, "basis basis"]) -> float:
    """Inner product in which every basis counts by its information."""
    products = one.reshape(len(one), -1) @ other.reshape(len(other), -1).T
    return float(np.sum(products * (mixing.T @ mixing)))


def _order(count: int) -> list[int]:
    """Subsets in an order in which neighbours are far apart."""
    stride = next(s for s in range(max(int(0.38 * count), 1), count + 1) if np.gcd(s, count) == 1)
    return [i * stride % count for i in range(count)]
