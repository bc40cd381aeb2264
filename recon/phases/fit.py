r"""Fit of all phases of a scan, from Gaussians that were fitted to all views as if nothing moved.

The unknowns are the coefficients b_p and the displacements d_p of each phase p; shapes are shared. What is lowered is

.. math:: \sum_p F_{\mathrm{data},p}(b_p, d_p) + \frac{\kappa}{2} \sum_{p,i} w_{pi}\,
    (b_{p+1,i} - b_{p,i})^\mathsf{T} H_i (b_{p+1,i} - b_{p,i})
    + \frac{\tau}{2} \sum_{p,i} (b_{p,i} - b^0_{p,i})^\mathsf{T} H_i (b_{p,i} - b^0_{p,i})

with F_data of `recon.gaussians.objective` over the views of a phase, and the curvature H_i of `recon.gaussians.fisher`
for one phase; kappa is ``coupling`` of `recon.phases.settings`, c its ``noise``, and tau its ``trust`` in the first
coefficients b^0, which follow voxels of each phase (`recon.phases.first_phases`). The weight
w = 1 / (1 + t / (c t_0)) of Cauchy's robust estimate lets go of Gaussians whose difference
t = (b_{p+1,i} - b_{p,i})^T H_i (b_{p+1,i} - b_{p,i}) is large beside the median t_0 of all: what rests is averaged over
all phases, what changes is not.
Displacements are linear between the nodes of a lattice; steps make them smooth in space and from phase to phase.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.data.measurements import Measurements, matching_bin
from recon.data.view_subsets import golden_section_order
from recon.gaussians.adam import Adam
from recon.gaussians.fisher import coefficient_curvature
from recon.gaussians.likelihood import likelihood_and_gradients
from recon.gaussians.model import GaussianModel
from recon.gaussians.recipe import Recipe
from recon.phases.first_phases import first_phases
from recon.phases.model import PhaseGaussians
from recon.phases.settings import PhaseSettings

# Part of the mean curvature of all Gaussians, and of its own, that is added to that of each; chosen by hand.
_MEAN_DAMPING, _OWN_DAMPING = 0.01, 0.01


@dataclass(frozen=True)
class PhaseProgress:
    """What a callback gets after every step.

    Parameters
    ----------
    step, steps : number of steps made, and of all steps; the first coefficients of a phase count as one
    phase : that the step belongs to
    deviance : of its views before the step, over its expected value; None for first coefficients
    """

    step: int
    steps: int
    phase: int
    deviance: float | None


def fit_phases(
    shared: GaussianModel,
    measured: Measurements,
    phase_of_view: Int[np.ndarray, " view"],
    cyclic: bool,
    grid: Grid,
    recipe: Recipe,
    settings: PhaseSettings,
    on_step: Callable[[PhaseProgress], object] = lambda progress: None,
) -> PhaseGaussians:
    """Fit the phases of a scan.

    Parameters
    ----------
    shared : Gaussians that were fitted to all views
    measured : these views
    phase_of_view : phase of each view, from 0 without gaps
    cyclic : whether the first phase follows the last
    grid : voxels that were fitted to all views
    recipe : of the fit to all views, for its pixels and its model error
    settings : how phases are fitted
    on_step : called after the first coefficients of each phase, and after every step

    Returns
    -------
    the phases
    """
    voxel = min(grid.spacing)
    data = measured.binned(matching_bin(measured.geometry, recipe.stages[-1].pixel * voxel)).weighted(recipe.dispersion)
    count = int(phase_of_view.max()) + 1
    views = [np.flatnonzero(phase_of_view == phase) for phase in range(count)]
    curvature = _curvature(shared, data, recipe) / count
    fisher = curvature.flatten(0, -3).double().mean(dim=0).numpy()
    done, total = count, (1 + settings.sweeps * settings.steps) * count

    def told(phase: int) -> None:
        on_step(PhaseProgress(phase + 1, total, phase, None))

    first = first_phases(shared, measured, phase_of_view, grid, fisher, settings, told)
    phases = PhaseGaussians.begin(*first, settings.spacing * voxel)
    steps = _PhaseSteps(phases, curvature, cyclic, voxel, recipe, settings, settings.sweeps * settings.steps)
    for step in range(settings.sweeps * settings.steps):
        for phase in golden_section_order(count):
            own = views[phase]
            part = own[golden_section_order(settings.steps)[step % settings.steps] :: settings.steps]
            deviance = steps.move(int(phase), data, part if len(part) else own, len(own), step)
            done += 1
            on_step(PhaseProgress(done, total, int(phase), deviance))
    return phases


def _curvature(
    shared: GaussianModel, data: Measurements, recipe: Recipe
) -> Float[Tensor, "gaussian *side basis basis"]:
    """Curvature of the data term of all views in the coefficients."""
    some = np.arange(0, len(data), max(len(data) // 24, 1))
    return coefficient_curvature(shared, data[some], recipe.dispersion) * (len(data) / len(some))


class _PhaseSteps:
    """What steps change besides the phases."""

    def __init__(
        self,
        phases: PhaseGaussians,
        curvature: Float[Tensor, "gaussian *side basis basis"],
        cyclic: bool,
        voxel: float,
        recipe: Recipe,
        settings: PhaseSettings,
        steps: int,
    ) -> None:
        self.phases, self.curvature, self.cyclic, self.voxel = phases, curvature, cyclic, voxel
        self.recipe, self.settings, self.steps = recipe, settings, steps
        diagonal = torch.diagonal(curvature, dim1=-2, dim2=-1)
        self.damping = torch.diag_embed(
            _OWN_DAMPING * diagonal + _MEAN_DAMPING * diagonal.flatten(0, -2).mean(dim=0).clamp_min(1e-30)
        )
        self.first, self.velocity = phases.coefficients.clone(), torch.zeros_like(phases.coefficients)
        self.adam = [Adam([nodes]) for nodes in phases.displacements]
        self.median = 0.0

    def move(self, phase: int, data: Measurements, views: np.ndarray, own: int, step: int) -> float:
        """Make a step of one phase with some of its views; return the deviance before it."""
        model = self.phases.at(phase)
        for part in model.tensors().values():
            part.requires_grad_()
        found = likelihood_and_gradients(model, data, views, self.recipe.dispersion)
        scale = own * float(np.prod(data.counts.shape[1:])) / 2
        assert model.coefficients.grad is not None
        assert model.centres.grad is not None
        with torch.no_grad():
            self._move_coefficients(phase, model.coefficients.grad * scale, step)
            self._move_nodes(phase, model.centres.grad * scale, step)
        return found.deviance

    def _neighbours(self, phase: int) -> list[int]:
        count = len(self.phases)
        if count == 1:
            return []
        if self.cyclic:
            return [(phase - 1) % count, (phase + 1) % count]
        return [p for p in (phase - 1, phase + 1) if 0 <= p < count]

    def _move_coefficients(self, phase: int, gradient: Tensor, step: int) -> None:
        """Make a step of Newton's method with momentum in the coefficients of a phase."""
        settings, all_phases = self.settings, self.phases.coefficients
        start = torch.einsum("...mn,...n->...m", self.curvature, all_phases[phase] - self.first[phase])
        gradient = gradient + settings.trust * start
        curvature = (1 + settings.trust) * self.curvature + self.damping
        for other in self._neighbours(phase):
            difference = all_phases[phase] - all_phases[other]
            pulled = torch.einsum("...mn,...n->...m", self.curvature, difference)
            size = (difference * pulled).sum(dim=-1).clamp_min(0)
            median = size.median()
            weight = settings.coupling / (1 + size / (settings.noise * median).clamp_min(1e-30))
            gradient = gradient + weight[..., None] * pulled
            curvature = curvature + weight[..., None, None] * self.curvature
        newton = torch.linalg.solve(curvature, gradient[..., None])[..., 0]
        fall = min(1.0, 4 * (1 - step / self.steps))
        moved = (
            settings.momentum * self.velocity[phase]
            - (1 - settings.momentum) * settings.coefficient_rate * fall * newton
        )
        if not self.phases.shared.SIGNED:
            moved = torch.maximum(moved, -all_phases[phase])
        self.velocity[phase] = moved
        all_phases[phase] += moved

    def _move_nodes(self, phase: int, gradient: Tensor, step: int) -> None:
        """Make a step of Adam in the displacements of a phase, and smooth them."""
        settings, lattice = self.settings, self.phases.lattice
        nodes, adam = self.phases.displacements[phase], self.adam[phase]
        length = settings.first_shift * (settings.last_shift / settings.first_shift) ** (step / self.steps)
        adam.tensors[0].grad = lattice.to_nodes(gradient)
        decays = self.recipe.optimizer.gradient_decay, self.recipe.optimizer.square_decay
        adam.step(np.array([length * self.voxel]), step + 1, decays)
        smooth = lattice.smoothed(nodes)
        others = [self.phases.displacements[p] for p in self._neighbours(phase)]
        nodes += settings.stiffness * (smooth - nodes)
        for other in others:
            nodes += settings.stiffness * (other - nodes) / len(others)
