"""Partial volume in pixels: they sum intensities, while a model that is fast knows one line integral of each.

Where an edge crosses a pixel, the mean of exp(-L) exceeds exp(-mean L). A fit to mean line integrals then finds too
little of what attenuates, and in the wrong basis, as soft energies suffer more. A model that is nearly right knows how
much: its intensities on finer rays, over that of its mean line integrals, tell what the counts are to be divided by.
"""

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from recon.array_store import IN_MEMORY, ArrayStore, release
from recon.gaussians import Gaussians
from recon.measurements import Measurements
from recon.processes import ALONE, Processes
from spectra.ops.transmit import transmit

RAYS = 2  # per pixel and direction


@torch.no_grad()
def without_partial_volume(
    measurements: Measurements,
    model: Gaussians,
    rays: int = RAYS,
    processes: Processes = ALONE,
    store: ArrayStore = IN_MEMORY,
) -> Measurements:
    """Counts as if each pixel were one ray, whose line integrals are the pixel's means.

    Parameters
    ----------
    measurements : to correct, in the pixels that a fit will use
    model : what was scanned, as far as is known
    rays : finer pixels per pixel and direction
    processes : that share the views; all get all counts
    store : where the corrected counts live
    """
    counts = store.empty("corrected", measurements.counts.shape)
    counts[:] = 0
    for view in processes.share(np.arange(len(measurements))):
        one = measurements[[int(view)]]
        counts[view] = one.counts[0] / _excess(one, model, rays).cpu().numpy()
    if processes.count > 1:
        whole = torch.from_numpy(counts)
        processes.add_up([whole])
    release(counts)
    return replace(measurements, counts=counts)


def _excess(one: Measurements, model: Gaussians, rays: int) -> Float[Tensor, "channel row column"]:
    """Mean of the expected counts of finer rays over that of their mean line integral, of a view; 1 without any."""
    fine = model.line_integrals(one.geometry.subdivided(rays))[0].movedim(0, -1)
    rows, columns = (n // rays for n in fine.shape[:2])
    blocks = fine.reshape(rows, rays, columns, rays, -1)
    mean, sub = blocks.mean(dim=(1, 3)), blocks.movedim(2, 1)
    through_mean, through_fine = _expected(mean, one), 0.0
    for i in range(rays):
        for j in range(rays):
            through_fine = through_fine + _expected(sub[:, :, i, j], one)
    through_fine = through_fine / rays**2
    return torch.where(through_mean > 0, through_fine / through_mean, 1.0).movedim(-1, 0)


def _expected(lengths: Float[Tensor, "row column basis"], one: Measurements) -> Float[Tensor, "row column channel"]:
    """Expected counts at exposure and gain 1."""
    if one.profile is not None:
        known = torch.from_numpy(one.profile).to(lengths).movedim(0, -1)
        lengths = torch.cat([lengths, known], dim=-1)
    return transmit(lengths.contiguous(), one.transmission)
