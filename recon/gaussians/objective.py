r"""The objective of the fit: the function F of the Gaussians theta that the steps of `recon.gaussians.optimize` lower.

.. math::

    \begin{aligned}
    F(\theta) &= F_\mathrm{data}(\theta) + F_\mathrm{prior}(\theta), \qquad b_{im} \ge 0 \\
    F_\mathrm{data}(\theta) &= \frac{1}{2} \sum_{v,c,r} s_{vcr}\, d_\eta\bigl(y_{vcr}, Y_{vcr}(\theta)\bigr) \\
    d_\eta(y, Y) &= 2 \Bigl[ y \ln\frac{y}{Y} - (y + k) \ln\frac{y + k}{Y + k} \Bigr], \qquad k = \eta^{-2} \\
    Y_{vcr}(\theta) &= g_{cr}\, e_{vc} \sum_j S_{cj} \exp\Bigl(-\sum_m B_m(E_j)\, L_{mvr}(\theta)\Bigr) \\
    s_{vcr} &= u_{vr}\, \min\Bigl(1, \min_{r' \in N(r)} \frac{\tilde{I}_{vcr'}}{I_{vcr}}\Bigr)\,
        \frac{\sigma_{vcr}^2}{\sigma_{vcr}^2 + \delta_{vcr}^2}, \qquad \sigma_{vcr}^2 = \frac{1}{y_{vcr}} + \eta^2 \\
    F_\mathrm{prior}(\theta) &= \frac{1}{2} \sum_x w_x\, \Delta(x)^\mathsf{T} W \Delta(x),
        \qquad \Delta_m(x) = \mu_m(x; \theta) - \mu^0_m(x) \\
    W &= \lambda\, \frac{\sum_i H_i}{\sum_x G(x)^2}, \qquad
        w_x = \max\bigl(1 - q_x,\; a\, \rho_x^{-4}\bigr)
    \end{aligned}

The data term sums over views v, channels c and rays (pixels) r; the prior sums over voxels x.

======== =============================== ============================================================================
symbol   in the code                     meaning
======== =============================== ============================================================================
theta    `Gaussians`                     centres, log_scales, quaternions, and coefficients b_im of Gaussian i, basis m
F_data   `recon.gaussians.likelihood`    data term: half the deviance of all counts
y        ``Measurements.counts``         measured counts, without partial volume
Y        ``expected``                    expected counts
d_eta    `recon.ops.deviance.deviance`   deviance of counts with variance Y + (eta Y)^2; of Poisson counts for eta = 0
eta      ``dispersion``                  model error: relative standard deviation of Y that is conceded
s        ``statistical_weights``         statistical weights of the counts, 0 to 1, by `Measurements.weighted`
u        ``Measurements.unseen_blocks``  0 for the rays that were set apart, else 1
I        `recon.data.partial_volume`     y over the open beam; with a tilde smoothed; N(r) are pixels within 2 of r
delta    `recon.data.partial_volume`     standard deviation of the correction for partial volume, beyond the least of
                                         the ray's channels
g, e     ``gains``, ``exposure``         gain of each pixel; output of the tube in each view
S, B, E  ``transmission``                photons times response, basis functions, energies of the nodes j
L        ``Gaussians.line_integrals``    line integrals of each basis, means over a pixel; then the known ones of a
                                         bowtie filter
F_prior  `recon.gaussians.voxel_prior`   voxel prior: squared distance from the volumes that the fit started from
mu       ``Gaussians.volume``            coefficients of each basis, means over a voxel [1/mm]
mu^0     ``VoxelPrior.volumes``          the volumes that the fit started from [1/mm]
W        ``prior_metric``                metric of the prior [mm^2]
lambda   ``VoxelPrior.strength``         strength: information of the prior over that of the data, ``Recipe.prior``
H_i      `recon.gaussians.fisher`        curvature of the data term in the coefficients of Gaussian i [mm^2]
G        ``density``                     sum of all Gaussians with coefficient 1
w        ``VoxelPrior.trust``            trust in the volumes
q        ``edge``                        strength of the strongest edge nearby, 0 to 1 (`recon.data.volume_edges`)
a        ``trust_along_edges``           `Recipe.prior_along_edges`
rho      ``over_metal``                  density over that of the least dense metal, at least 1
======== =============================== ============================================================================

Held fixed are y, g, e, S, B, s, mu^0 and w for the whole fit, and W between two computations of the curvature. The
coefficients of K edges in metal keep their values. In the prior, Gaussians end at a cutoff, and mu^0 is multiplied by
the part of a Gaussian's mass within it.

Where planes divide the Gaussians (`recon.gaussians.divided.model`), coefficients have either sign, theta also has the
offsets of the planes, and line integrals below 0 enter Y by `recon.gaussians.likelihood.bounded`.

On a curve of materials (`recon.gaussians.on_curve`), coefficients move along the mixture of materials of their side.

A step uses some of the views, scaled to all of them, and one slab of the voxels, scaled to the whole volume; the mean
of its gradient over the steps is that of F. Gradients are of F over half the number of counts (`Objective.scale`).

Where views do not see all of the volume, as in a helix, few views of a step or none see a Gaussian. Scaled to all
views, their gradient is too large or 0. So the gradients of coefficients, and H_i, are scaled by the numbers of views
that see the centre: from those of the step, or of those that H_i is computed from, to those of the scan. A Gaussian
takes a whole step of Newton's method whenever it is seen.
"""

from dataclasses import dataclass
from typing import NamedTuple, cast

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import ConvexHull, QhullError
from torch import Tensor

from phantomgen.geometry.curved_panel import sees
from phantomgen.geometry.poses import Geometry
from recon.data.measurements import Measurements
from recon.data.view_subsets import every_nth_view, view_groups
from recon.gaussians.divided.model import DividedGaussians
from recon.gaussians.fisher import coefficient_curvature
from recon.gaussians.likelihood import Likelihood, likelihood_and_gradients
from recon.gaussians.model import GaussianModel
from recon.gaussians.processes import ALONE, Processes
from recon.gaussians.settings import OptimizerSettings
from recon.gaussians.voxel_prior import VoxelPrior


class Curvature(NamedTuple):
    """Second derivatives that steps use.

    Parameters
    ----------
    inverse : inverse blocks of the curvature of F in the coefficients, (N, M, M) [1/mm^2]
    prior_metric : W, (M, M) [mm^2]; empty without a prior
    """

    inverse: Float[Tensor, "gaussian *side basis basis"]
    prior_metric: Float[Tensor, "..."]


@dataclass(frozen=True, eq=False)
class Objective:
    """F for some measurements.

    Parameters
    ----------
    data : views with statistical weights s
    dispersion : eta, relative model error [no unit]
    prior : the voxel prior; None for the data term alone
    processes : those that share the views
    seen : which views see which Gaussians, from `seen_gaussians`; None where all see all
    """

    data: Measurements
    dispersion: float
    prior: VoxelPrior | None = None
    processes: Processes = ALONE
    seen: Bool[np.ndarray, "view gaussian"] | None = None

    @property
    def scale(self) -> float:
        """Half the number of counts: F over the mean deviance."""
        return float(np.prod(self.data.counts.shape)) / 2

    def set_gradients(
        self, gaussians: GaussianModel, views: Int[np.ndarray, " view"], prior_metric: Float[Tensor, "..."], step: int
    ) -> Likelihood:
        """Leave the gradients of F over `scale`, estimated from some views and one slab, in the arrays of a model.

        Parameters
        ----------
        gaussians : model whose arrays require gradients
        views : indices of the views to use
        prior_metric : W, from `curvature`
        step : number of the step, which selects the slab of the prior

        Returns
        -------
        likelihood of the model with these views
        """
        found = likelihood_and_gradients(gaussians, self.data, views, self.dispersion, self.processes)
        if self.seen is not None:
            gradient = cast(Tensor, gaussians.coefficients.grad)
            gradient *= _like(self._to_all_views(views) * len(views) / len(self.data), gradient)
        if self.prior is not None:
            self.prior.add_gradients(gaussians, prior_metric / self.scale, step)
        return found

    def curvature(self, gaussians: GaussianModel, settings: OptimizerSettings) -> Curvature:
        """Compute the curvature of F in the coefficients, from some of the views, and the metric of the prior.

        Parameters
        ----------
        gaussians : the model
        settings : number of views, damping, and how coefficients are held

        Returns
        -------
        inverse of the damped curvature, and W
        """
        data = self.data
        seeing = len(data) * (1.0 if self.seen is None else float(self.seen.mean()))  # views, for a Gaussian on average
        some = every_nth_view(view_groups(data.exposure), max(int(-(-seeing // settings.curvature_views)), 1))
        blocks = coefficient_curvature(gaussians, data[self.processes.share(some)], self.dispersion)
        self.processes.add_up([blocks])
        if self.seen is None:
            blocks = blocks * (len(data) / len(some))
        else:
            blocks = blocks * _like(self._to_all_views(some), blocks)
        metric = torch.empty(0)
        if self.prior is not None:
            blocks, metric = self.prior.curvature(gaussians, blocks)
        diagonal = torch.diagonal(blocks, dim1=-2, dim2=-1)
        mean = diagonal.flatten(0, -2).mean(dim=0).clamp_min(1)
        damping = settings.mean_damping
        if self.seen is not None:  # the curvature of Gaussians that none of these views sees is not known
            damping = _like(np.where(self.seen[some].any(axis=0), damping, 1.0), diagonal)
        added = settings.relative_damping * diagonal + damping * mean
        held = None if self.prior is None else self.prior.held_coefficients(gaussians)
        if held is not None:
            added = added + settings.holding * held * diagonal
        whole = blocks + torch.diag_embed(added)
        if self.prior is not None and self.prior.on_curve is not None:
            from recon.gaussians.on_curve.directions import along  # noqa: PLC0415 - only on a curve

            return Curvature(along(whole, self.prior.on_curve.directions(cast(DividedGaussians, gaussians))), metric)
        return Curvature(torch.linalg.inv(whole), metric)

    def _to_all_views(self, views: Int[np.ndarray, " view"]) -> Float[np.ndarray, " gaussian"]:
        """Divide the number of views of the scan that see a Gaussian by that of some of them, at least 1.

        Where no view has the centre on its panel, and a tail at most, all views count.
        """
        assert self.seen is not None
        all_views, few = self.seen.sum(axis=0), self.seen[views].sum(axis=0)
        return np.where(all_views == 0, len(self.seen) / len(views), all_views / np.maximum(few, 1))


def seen_gaussians(gaussians: GaussianModel, geometry: Geometry) -> Bool[np.ndarray, "view gaussian"] | None:
    """Find the views with the centre of each Gaussian on their panel.

    Parameters
    ----------
    gaussians : the model
    geometry : poses of all views

    Returns
    -------
    whether a view sees a Gaussian, (V, N); None where all views see all Gaussians
    """
    centres = gaussians.centres.detach().cpu().numpy().astype(np.float64)
    if sees(geometry, _outermost(centres)).all():
        return None
    return np.concatenate([sees(geometry[[view]], centres) for view in range(len(geometry))])


def _outermost(points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "corner 3"]:
    """Find the corners of the convex hull; all points where they span no volume."""
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:
        return points


def _like(factors: Float[np.ndarray, " gaussian"], values: Tensor) -> Tensor:
    """Shape a factor of each Gaussian for multiplication with arrays of more dimensions."""
    return torch.from_numpy(factors).to(values).reshape(-1, *[1] * (values.ndim - 1))
