"""One-step reconstruction of voxels: from counts to basis volumes without line integrals in between.

The method minimises half the deviance of all counts, all channels together, plus a joint total variation, over
non-negative coefficients. Each step minimises a separable quadratic surrogate of the likelihood of some of the views
(ordered subsets), with blocks that couple the bases, and Nesterov's momentum, which restarts where it points against
the descent. The total variation and x >= 0 are solved for in the metric of the surrogate, by a few dual steps that
start from the last dual. Coarse voxels come first, with pixels summed to match, so that no other reconstruction is
needed as a start; their edges are sharpened before finer voxels follow, which saves these most of their passes.

Rays close to each other have equal statistical weight, as voxels cannot resolve them (`recon.data.partial_volume`).
The total variation has less weight where the counts carry little information, as behind thick metal; the values there
are returned as means over voxels (`means_in_metal`). Memory grows with voxels, not with views: some 40 volumes of
32-bit numbers for three bases.

References
----------
Surrogates: Weidinger et al. 2016, doi:10.1155/2016/5871604; Mechlem et al. 2018, doi:10.1109/TMI.2017.2726687. Momentum
with subsets: Kim, Ramani, Fessler 2015, doi:10.1109/TMI.2014.2350962. Restart: O'Donoghue & Candes 2015,
doi:10.1007/s10208-013-9150-3. Steps as long as the change that is expected of a voxel: Kim et al. 2013,
doi:10.1109/TMI.2013.2266898.
"""

from dataclasses import dataclass
from math import ceil, sqrt
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from scipy.ndimage import convolve1d, minimum_filter
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.data.measurements import Measurements, matching_bin
from recon.data.view_subsets import (
    count_complete_sets,
    every_nth_view,
    golden_section_order,
    interleaved_subsets,
    view_groups,
)
from recon.data.volume_edges import contrast_around, metal_without_agents, over_metal
from recon.ops.nonnegative_newton import as_matrices, inverse_blocks, nonnegative_newton_step
from recon.ops.total_variation import ascend, neighbour_sums
from recon.ops.total_variation import gradient as total_variation_gradient
from recon.voxel.iterative.likelihood import curvature, deviance_and_gradient
from recon.voxel.iterative.multigrid import coarser, occupied, resampled, sharpened
from recon.voxel.method import OnIteration, Report, Volumes, no_callback
from spectra.errors import InputError
from spectra.materials.material_curve import MaterialCurve
from spectra.threads import without_other_pools

# views of a kind; distance of two views whose curvature is computed, as that of the others is similar; no whole number,
# so that it follows no period of the orbit; chosen by hand, not measured
CURVATURE_STEP = 3.236
# views whose curvature is computed at least, where there are as many: a voxel that few of them see takes too long
# steps; with 3 of 9 views, voxels at a corner of the grid ended at 30 per mm; of 40 views on an arc of 120 degrees, all
# have 37.4 / 29.8 / 38.2 dB, every second one 37.3 / 29.8 / 36.0 and every fourth one 14 / 12 / 11 dB
LEAST_CURVATURE_VIEWS = 40
# no unit, over the change at a full edge; steps of a voxel in an even region are shorter by so much. 1 needs nearly
# twice as many passes, 0.08 as many, as measured when it was chosen
# (docs/development/decisions/0017-full-size-voxels-first.md)
LEAST_CHANGE = 0.15
# no unit, over the least deviance of a pass; where a pass exceeds it, the subsets have diverged, and half as many go on
# from the best volumes; chosen by hand, not measured
DIVERGED = 1.5
# no unit, over the typical curvature; below it the total variation has less weight; a quarter, with power 1, is 1 dB
# worse with an implant, as measured when it was chosen (docs/development/decisions/0009-metal.md)
LOW_CURVATURE = 0.5
# no unit; power of the relative curvature with which the total variation fades, between that of noise (0.5) and that of
# information (1); by its root, an opaque block of 2 per mm ends at 1.4 (as above)
CURVATURE_POWER = 0.7
# passes of a level; after them the curvature is computed again at the current volumes; chosen by hand, not measured
METRIC_RENEWED = 3
# views; of more, subsets are more and passes fewer in proportion; with 180 views of development.yaml that has the same
# PSNR within 0.1 dB in half the time, as measured when it was chosen
MANY_VIEWS = 100
# passes; the least number for any number of views; chosen by hand, not measured
FEWEST_PASSES = 2
# views; of fewer, passes are more by the root of 75 over their number, as measured with 10 and 25 views when it was
# chosen
FEW_VIEWS = 75
# no unit; passes over those asked for, at most, where the deviance still falls; chosen by hand, not measured
MOST_TIMES = 3
# no unit; precision of the prior of K edges at 0 over their curvature, in metal twice as dense as the least dense one;
# ten times as much gains 0.3 dB of iodine and loses 0.4 dB of Compton beside a pin, as above
AGENT_PRIOR = 0.1
# no unit, over the mean curvature; floor of the curvature, so that voxels without rays stay as they are; 1e-3 holds
# back voxels in thick metal, as above
CURVATURE_FLOOR = 1e-4
# no unit; weights of voxel centres in the mean of a piecewise linear function over a voxel; exact
_MEAN = (1 / 8, 3 / 4, 1 / 8)


@dataclass(frozen=True)
class OneStep:
    """One-step reconstruction with its settings.

    Levels, strength and dispersion were compared by `benchmarks.reconstruction.comparison_methods`
    (`docs/reference/benchmarks/voxel_methods.md`); the other values were chosen by hand.

    Parameters
    ----------
    levels : size of the voxels of each level [voxels of the requested grid], and passes over the views; more than 100
        views take fewer passes, fewer than 75 take more; with an initial volume use level 1 alone
    pixel : largest pixel as seen at the isocentre [voxels of the level]; smaller ones are summed
    subsets : number of subsets of the views, more for more than 100 views; with few views, more than 6 may diverge
    dispersion : relative model error added to the Poisson variance [no unit]
    strength : weight of the total variation; at 1 its bound equals the standard deviation of the gradient of a voxel
    dual_steps : steps on the dual of the total variation per step of the likelihood
    momentum : whether to use Nesterov's momentum
    curve : materials of the object; then the attenuation at one energy is the only unknown of a voxel, and one channel
        determines it; None for coefficients of all bases
    least_fall : passes of the last level go on, up to `MOST_TIMES` as many, as long as one lowers the deviance by more
        than this part; None for as many passes as are asked for
    device : where rays and voxels are computed, ``cpu`` or ``cuda``; with a curve always by the processor
    """

    levels: tuple[tuple[int, int], ...] = ((4, 8), (2, 8), (1, 8))
    pixel: float = 1.0
    subsets: int = 5
    dispersion: float = 0.03
    strength: float = 1.5
    dual_steps: int = 3
    momentum: bool = True
    curve: MaterialCurve | None = None
    least_fall: float | None = None
    device: str = "cpu"

    @property
    def name(self) -> str:
        """Name of the method, as in ``--method``."""
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
        on_iteration: OnIteration = no_callback,
        start: Volumes | None = None,
    ) -> Volumes:
        """Reconstruct volumes from counts; any number of threads gives the same ones.

        Parameters
        ----------
        measurements : views to use, unbinned, of any orbit
        grid : the volume to reconstruct
        on_iteration : called after every pass over the views, with the deviance per count
        start : initial volumes on `grid` [1/mm], zeros by default; what lies outside of the box that they fill stays
            empty

        Returns
        -------
        volumes of the bases [1/mm]
        """
        unknowns = len(measurements.basis_names) if self.curve is None else 1
        volumes, here = np.zeros((unknowns, *grid.shape), np.float32), grid
        if start is not None:
            volumes = start.astype(np.float32)
        levels = [(factor, _passes(passes, measurements)) for factor, passes in self.levels]
        report = Report(on_iteration, sum(passes for _, passes in levels))
        for number, (factor, passes) in enumerate(levels):
            level = coarser(grid, factor)
            finer = min(level.spacing) < min(here.spacing)
            volumes, here = resampled(volumes, here, level), level
            if finer:
                volumes = sharpened(volumes)
            data = measurements.binned(matching_bin(measurements.geometry, self.pixel * min(level.spacing)))
            data = data.weighted(self.dispersion)
            last = number == len(levels) - 1
            volumes = _descend(volumes, data, level, self, passes, report, self.least_fall if last else None)
        return self.coefficients(_voxel_means(resampled(volumes, here, grid), self))

    @without_other_pools()
    def refine(
        self, volumes: Volumes, measurements: Measurements, grid: Grid, on_iteration: OnIteration = no_callback
    ) -> Volumes:
        """Add to volumes what the counts ask for; the priors are those of what is added.

        Parameters
        ----------
        volumes : coefficients on `grid`, whose edges are to stay; what lies outside of the box that they fill stays
            empty [1/mm]
        measurements : views to use, unbinned, of any orbit
        grid : grid of the volumes
        on_iteration : called after every pass over the views, with the deviance per count

        Returns
        -------
        volumes of the bases, not negative [1/mm]
        """
        data = measurements.binned(matching_bin(measurements.geometry, self.pixel * min(grid.spacing)))
        passes = _passes(self.levels[-1][1], measurements)
        report = Report(on_iteration, passes)
        return _descend(volumes, data.weighted(self.dispersion), grid, self, passes, report, around=True)

    def coefficients(self, unknowns: Float[np.ndarray, "unknown z y x"]) -> Volumes:
        """Compute the coefficients of the bases.

        Parameters
        ----------
        unknowns : of each voxel [1/mm]: the coefficients, or with a curve the attenuation at its energy

        Returns
        -------
        coefficients [1/mm]
        """
        return unknowns if self.curve is None else self.curve.values(unknowns[0])


def means_in_metal(volumes: Volumes) -> Volumes:
    """Replace values in metal by means over voxels.

    The projector interpolates between the centres of voxels, so that values which fit the rays are values at centres.
    The mean of the interpolated function over a voxel is 3/4 of its own value and 1/8 of that of each neighbour, along
    each axis. Outside of metal the total variation prefers piecewise constant volumes, whose edges lie on faces of
    voxels and whose values are means already. In metal, where it has little weight, values overshoot and those beside
    them are too low.

    Parameters
    ----------
    volumes : values at the centres of voxels [1/mm]

    Returns
    -------
    volumes with means in metal, the more the denser it is [1/mm]
    """
    over = over_metal(volumes)
    if over.max(initial=1) <= 1:
        return volumes
    means = volumes
    for axis in (1, 2, 3):
        means = convolve1d(means, _MEAN, axis=axis, mode="nearest")
    return volumes + (1 - 1 / over**2).astype(np.float32) * (means - volumes)


def _descend(
    volumes: Volumes,
    data: Measurements,
    grid: Grid,
    settings: OneStep,
    passes: int,
    report: Report,
    least_fall: float | None = None,
    around: bool = False,
) -> Volumes:
    """Improve volumes on one grid, inside the box that holds the object; where subsets diverge, fewer of them go on.

    With `least_fall`, more passes follow as long as each lowers the deviance by more than this part of it. With
    `around`, the priors are those of the difference from the given volumes.
    """
    box = occupied(volumes)
    inner, whole = grid.part(box), np.zeros_like(volumes)
    counts = max(int(np.count_nonzero(data.gains, axis=(1, 2)) @ np.count_nonzero(data.exposure, axis=0)), 1)
    first = _on_device(np.ascontiguousarray(volumes[:, *box]), settings)
    field = _on_device(np.zeros((3, *first.shape), np.float32), settings)
    state = _State(first, field, around=first if around else None)
    ratio, best, least, metric = _view_ratio(data), first, np.inf, None
    parts = min(round(ratio * settings.subsets), _views_of_a_kind(data))
    last, most = np.inf, passes * (1 if least_fall is None else MOST_TIMES)
    for i in range(most):
        if metric is None or i == ceil(METRIC_RENEWED / ratio):
            metric = _metric(_as_array(state.volumes), data, inner, settings)
        before = state.volumes
        deviance = _pass(state, data, inner, settings, metric, parts)
        if not deviance < DIVERGED * least and parts > 1:
            state = _State(best, 0.0 * state.field, around=state.around)
            parts = parts // 2 | 1
        elif deviance < least:
            best, least = before, deviance  # the last steps of a pass may be those that diverge
        shown = _as_array(state.volumes)
        whole[:, *box] = shown if around else _voxel_means(shown, settings)
        report(settings.coefficients(whole), deviance / counts, grid)
        if i + 1 >= passes and least_fall is not None:
            if not deviance < (1 - least_fall) * last:
                break
            report.expect_more(1)
        last = deviance
    whole[:, *box] = _as_array(state.volumes)
    return whole


def _on_device(values: Float[np.ndarray, "..."], settings: OneStep) -> Any:
    """Make a tensor of an array where a GPU computes."""
    here = settings.device == "cpu" or settings.curve is not None
    return values if here else torch.from_numpy(values).to(settings.device)


def _as_array(values: Any) -> Float[np.ndarray, "..."]:
    """Make an array of a tensor."""
    return values.cpu().numpy() if isinstance(values, Tensor) else values


def _passes(asked: int, data: Measurements) -> int:
    """Passes of a level, fewer than asked for with many views of each kind and more with few views."""
    if len(data) < FEW_VIEWS:
        return ceil(asked * sqrt(FEW_VIEWS / len(data)))
    return max(ceil(asked / _view_ratio(data)), min(asked, FEWEST_PASSES))


def _views_of_a_kind(data: Measurements) -> int:
    """Number of views of each kind: where the tube voltage switches, a step has so many fewer of each."""
    return count_complete_sets(view_groups(data.exposure))


def _view_ratio(data: Measurements) -> float:
    """Views of a kind over `MANY_VIEWS`, at least 1; so many times more subsets in fewer passes are as many steps."""
    return max(_views_of_a_kind(data) / MANY_VIEWS, 1.0)


def _voxel_means(volumes: Volumes, settings: OneStep) -> Volumes:
    """Volumes with means in metal; without a total variation, values stay as they fit the rays everywhere."""
    return means_in_metal(volumes) if settings.strength else volumes


@dataclass
class _State:
    """State of a descent: volumes, dual of the total variation, extrapolated point of the next step, momentum.

    Volumes (basis, z, y, x) and dual (axis, basis, z, y, x) are arrays, or tensors where a GPU computes. The total
    variation and the prior of K edges are those of the difference from `around`, where there is one.
    """

    volumes: Any
    field: Any
    point: Any = None
    speed: float = 1.0
    around: Any = None


def _pass(state: _State, data: Measurements, grid: Grid, settings: OneStep, metric: "_Metric", parts: int) -> float:
    """Use every view once, in so many subsets, and return the sum of the deviances before the steps."""
    total, restart_test = 0.0, 0.0
    subsets = interleaved_subsets(view_groups(data.exposure), parts)
    for number in golden_section_order(len(subsets)):
        some = data[subsets[number]]
        point = state.volumes if state.point is None else state.point
        deviance, gradient = _deviance_and_gradient(point, some, grid, settings)
        gradient *= len(data) / len(some)
        new = _proximal(point, gradient, state, metric, grid, settings)
        step = new - state.volumes
        restart_test += _inner(point - new, step, metric.mixing)
        faster = (1 + np.sqrt(1 + 4 * state.speed**2)) / 2 if settings.momentum else 1.0
        state.point = new + float((state.speed - 1) / faster) * step
        state.volumes, state.speed = new, faster
        total += deviance
    if restart_test > 0:
        state.point, state.speed = None, 1.0
    return total


@dataclass(frozen=True)
class _Metric:
    """Metric of the surrogate.

    Inverse blocks (pair, z, y, x); matrix W by which the total variation mixes the bases; steps of its dual (z, y, x)
    and their bounds; precision of the prior at 0, None where there is no metal.
    """

    inverse: Any
    mixing: Float[np.ndarray, "basis basis"]
    steps: Any
    bounds: Any
    empty: Any = None


def _deviance_and_gradient(unknowns: Any, data: Measurements, grid: Grid, settings: OneStep) -> tuple[float, Any]:
    """Deviance of the counts, and the gradient of half of it in the unknowns."""
    if settings.curve is None:
        return deviance_and_gradient(unknowns, data, grid, settings.dispersion)
    deviance, gradient = deviance_and_gradient(settings.coefficients(unknowns), data, grid, settings.dispersion)
    return deviance, np.einsum("mzyx,mzyx->zyx", settings.curve.slopes(unknowns[0]), gradient)[None]


def _curvature(
    unknowns: Volumes, data: Measurements, grid: Grid, settings: OneStep
) -> tuple[Float[np.ndarray, "pair z y x"], Float[np.ndarray, "unknown unknown"], Float[np.ndarray, "unknown z y x"]]:
    """`recon.voxel.iterative.likelihood.Curvature` in the unknowns; along a curve, its bend is left out."""
    if settings.curve is None:
        return curvature(unknowns, data, grid, settings.dispersion, _changes(unknowns), settings.device)
    blocks, covariance, _ = curvature(settings.coefficients(unknowns), data, grid, settings.dispersion)
    slopes = settings.curve.slopes(unknowns[0])
    pairs = zip(*np.triu_indices(len(slopes)), strict=True)
    along = sum((1 + (m != n)) * slopes[m] * slopes[n] * block for (m, n), block in zip(pairs, blocks, strict=True))
    weights = unknowns[0] + np.float32(1e-30)
    typical = np.einsum("mzyx,zyx->m", slopes, weights / weights.sum())
    block = np.asarray(along)[None]
    return block, np.array([[typical @ covariance @ typical]]), block.copy()


def _metric(volumes: Volumes, data: Measurements, grid: Grid, settings: OneStep) -> _Metric:
    """Compute the metric at volumes.

    Voxels where values change from one to the next have most of their way to go on a finer level, so that they take
    longer steps than those of an even region (`_changes`).

    Metal holds no contrast agent, but no combination of bases attenuates as metal does, and the difference resembles a
    K edge. So K edges have a prior at 0 in metal, the stronger the denser the metal.
    """
    step = min(CURVATURE_STEP, max(_views_of_a_kind(data) / LEAST_CURVATURE_VIEWS, 1.0))
    some = data[every_nth_view(view_groups(data.exposure), step)]
    share = len(data) / len(some)
    blocks, covariance, information = _curvature(volumes, some, grid, settings)
    upper = np.triu_indices(len(volumes))
    diagonals = np.float32(share) * information
    blocks *= np.float32(share)
    empty, edges, over = None, np.zeros(1), np.ones(1)
    if settings.curve is None:
        edges, over = metal_without_agents(volumes, data.basis_names)
    if over.max(initial=1) > 1:
        empty = edges[:, None, None, None] * (diagonals * np.float32(AGENT_PRIOR) * (over - 1))
        empty = empty.astype(np.float32)
        blocks[upper[0] == upper[1]] += empty
    inverse = inverse_blocks(blocks, CURVATURE_FLOOR * diagonals.mean(axis=(1, 2, 3)) + 1e-30)
    ridge = (1e-12 * np.trace(covariance) + 1e-30) * np.eye(len(volumes))
    mixing = np.sqrt(share) * np.linalg.cholesky(covariance + ridge).T
    bounds = np.float32(settings.strength) * _statistical_weights(information, volumes.sum(axis=0))
    inverse = _on_device(inverse, settings)
    steps = 1 / neighbour_sums(_largest(inverse, mixing), grid)
    steps, bounds = (_on_device(part, settings) for part in (steps, bounds))
    return _Metric(inverse, mixing, steps, bounds, None if empty is None else _on_device(empty, settings))


def _changes(volumes: Volumes) -> Float[np.ndarray, "z y x"]:
    """Expected change of each voxel over the largest one, by the contrast around it; 1 everywhere in empty volumes."""
    if not volumes.any():
        return np.ones(volumes.shape[1:], np.float32)
    return np.clip(np.sqrt(contrast_around(volumes)), LEAST_CHANGE, 1).astype(np.float32)


def _statistical_weights(
    curvatures: Float[np.ndarray, "basis z y x"], density: Float[np.ndarray, "z y x"]
) -> Float[np.ndarray, "z y x"]:
    """Weight of the total variation in every voxel: 1, and less where the curvature is far below the typical one.

    The amount by which a total variation lowers an edge is its weight over the information of the rays. With the same
    weight everywhere, it would dominate where rays carry little information: in thick metal it would exchange
    photoelectric absorption for Compton scattering until their edges were smallest. With a weight in proportion to the
    information, edges in metal would stay as soft as the rays show them. So the weight follows a power in between. It
    is the least of a voxel and its neighbours.
    """
    weights = density / density.sum() if density.any() else np.full_like(density, 1 / density.size)
    typical = np.einsum("bzyx,zyx->b", curvatures, weights)
    relative = (curvatures / np.maximum(typical, 1e-30)[:, None, None, None]).mean(axis=0)
    return minimum_filter(np.minimum((relative / LOW_CURVATURE) ** CURVATURE_POWER, 1), 3)


def _largest(inverse: Any, mixing: Float[np.ndarray, "basis basis"]) -> np.ndarray:
    """Upper bound of the eigenvalues of W H^-1 W^T in every voxel: the Frobenius norm."""
    if isinstance(inverse, Tensor):  # it is linear in the pairs before the norm
        units = as_matrices(np.eye(len(inverse))).astype(mixing.dtype)
        factors = inverse.new_tensor((mixing @ units @ mixing.T).reshape(len(units), -1))
        return torch.stack([(row.movedim(0, -1) @ factors).norm(dim=-1) for row in inverse.unbind(1)]).cpu().numpy()
    out = np.empty(inverse.shape[1:], np.float32)
    for z in range(len(out)):
        mixed = mixing @ as_matrices(inverse[:, z]) @ mixing.T
        out[z] = np.sqrt(np.square(mixed).sum(axis=(-2, -1)))
    return out


def _proximal(point: Any, gradient: Any, state: _State, metric: _Metric, grid: Grid, settings: OneStep) -> Any:
    """Approximate minimum of surrogate plus total variation over x >= 0; the dual of the state is improved in place."""
    field = state.field
    if metric.empty is not None:
        gradient = gradient + metric.empty * (point if state.around is None else point - state.around)
    if settings.strength == 0:
        return nonnegative_newton_step(point, metric.inverse, gradient)
    new = nonnegative_newton_step(
        point, metric.inverse, gradient + total_variation_gradient(field, metric.mixing, grid)
    )
    for _ in range(settings.dual_steps):
        varied = new if state.around is None else new - state.around
        ascend(field, varied, metric.mixing, grid, metric.steps, metric.bounds)
        new = nonnegative_newton_step(
            point, metric.inverse, gradient + total_variation_gradient(field, metric.mixing, grid)
        )
    return new


def _inner(one: Any, other: Any, mixing: Float[np.ndarray, "basis basis"]) -> float:
    """Inner product in which every basis is weighted by its information."""
    products = one.reshape(len(one), -1) @ other.reshape(len(other), -1).T
    return float(np.sum(_as_array(products) * (mixing.T @ mixing)))
