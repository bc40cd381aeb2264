"""The fit of divided Gaussians to voxel volumes, by accelerated gradient steps."""

from dataclasses import replace
import math

import numpy as np
import torch

from recon.gaussians.interface.steps import GEOMETRY, curvatures, gradient_of_steps, moved
from recon.gaussians.settings import VolumeFitSettings


def follow(model, volumes, grid, metric, evaluations, settings=VolumeFitSettings(cutoff=4.0), signed=False, report=None, widest=2.0):
    target = torch.from_numpy(np.ascontiguousarray(volumes)).float()
    metric = torch.from_numpy(metric / np.trace(metric)).float()
    inverse = torch.linalg.inv(metric)
    bases = len(volumes)
    voxel = min(grid.spacing)
    ceiling = model.log_scales.amax(dim=1, keepdim=True) + math.log(widest)

    def evaluate(model):
        parts = {name: value.detach().requires_grad_() for name, value in model.tensors().items()}
        found = replace(model, **parts).voxels(grid, settings.cutoff)
        away = found.detach() - target
        weighted = torch.einsum("mn,nzyx->mzyx", metric, away)
        found.backward(weighted)
        value = 0.5 * float((away * weighted).sum(-1).sum(dtype=torch.float64))
        return value, gradient_of_steps(model, [p.grad for p in parts.values()])

    def diagonal(model):
        one = torch.ones_like(model.coefficients[..., :1]).requires_grad_()
        density = model.with_values(one).voxels(grid, settings.cutoff)
        density.backward(density.detach())
        per_side = one.grad[..., 0]
        c = curvatures(model, metric, voxel, per_side.sum(1), None, settings.least_energy) + 1e-12
        return c, per_side.clamp_min(1e-3)

    def limited(step, model):
        longest = 0.5 * torch.sqrt(torch.exp(2 * model.log_scales) + voxel**2 / 12)
        a, b, c, d, e = step.split((3, 3, 3, 1, step.shape[1] - 10), 1)
        return torch.cat([torch.clamp(a, -longest, longest), b.clamp(-0.3, 0.3), c.clamp(-0.2, 0.2), d.clamp(-0.5 * voxel, 0.5 * voxel), e], 1)

    value, gradient = evaluate(model)
    last, since, length = torch.zeros_like(gradient), 0, settings.step_length
    done, renewed = 1, -9
    while done < evaluations:
        if done >= renewed + settings.renewal:
            geometry, sides = diagonal(model)
            renewed = done
        if float((last * gradient).sum()) > 0:
            last, since = torch.zeros_like(last), 0
        held = torch.zeros_like(gradient, dtype=torch.bool)
        held[:, 3:6] = (model.log_scales >= ceiling) & (gradient[:, 3:6] < 0)
        if not signed:
            held[:, GEOMETRY:] = (model.coefficients.flatten(1) <= 0) & (gradient[:, GEOMETRY:] > 0)
        g = gradient.masked_fill(held, 0)
        change = (g[:, GEOMETRY:].reshape(-1, 2, bases) @ inverse / sides[..., None]).flatten(1)
        pre = torch.cat([g[:, :GEOMETRY] / geometry, change], 1)
        inertia = min(settings.momentum, since / (since + 3))
        step = limited((inertia * last - length * pre).masked_fill(held, 0), model)
        ahead = moved(model, step, signed)
        ahead = replace(ahead, log_scales=torch.minimum(ahead.log_scales, ceiling))
        there, slope = evaluate(ahead)
        done += 1
        if there > settings.rise * value:
            last, since, length = torch.zeros_like(last), 0, settings.shortening * length
            continue
        step[:, 3:6] = ahead.log_scales - model.log_scales
        step[:, GEOMETRY:] = (ahead.coefficients - model.coefficients).flatten(1)
        model, value, gradient, last, since = ahead, there, slope, step, since + 1
        if report:
            report(done, value, model)
    return model
