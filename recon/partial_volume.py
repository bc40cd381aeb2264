"""Partial volume in pixels: they sum intensities, while a model that is fast knows one line integral of each.

Where an edge crosses a pixel, the mean of exp(-L) exceeds exp(-mean L). A fit to mean line integrals then finds too
little of what attenuates, and in the wrong basis, as soft energies suffer more. A model that is nearly right knows how
much: its intensities on finer rays, over that of its mean line integrals, tell what the counts are to be divided by.
"""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from recon.array_store import IN_MEMORY, ArrayStore, release
from recon.gaussians import Gaussians
from recon.measurements import Measurements
from spectra.ops.transmit import transmit

RAYS = 2  # per pixel and direction


@torch.no_grad()
def without_partial_volume(
    measurements: Measurements, model: Gaussians, store: ArrayStore = IN_MEMORY, rays: int = RAYS
) -> Measurements:
    """Counts as if each pixel were one ray, whose line integrals are the pixel's means.

    Parameters
    ----------
    measurements : to correct, in the pixels that a fit will use
    model : what was scanned, as far as is known
    store : where the corrected counts live
    rays : finer pixels per pixel and direction
    """
    counts = store.empty("corrected", measurements.counts.shape)
    for view, image in enumerate(counts):
        one = measurements[[view]]
        image[:] = one.counts[0] / _excess(one, model, rays).cpu().numpy()
    release(counts)
    return replace(measurements, counts=counts)


def _excess(one: Measurements, model: Gaussians, rays: int) -> Float[Tensor, "channel row column"]:
    """Mean of the expected counts of finer rays over those of their mean line integrals, of a view; 1 without any."""
    fine = model.line_integrals(one.geometry.subdivided(rays))[0]
    rows, columns = one.counts.shape[2:]
    rays_of_pixels = fine.reshape(-1, rows, rays, columns, rays).permute(1, 3, 2, 4, 0)
    of_rays = _expected(rays_of_pixels, one).mean(dim=(2, 3))
    of_means = _expected(rays_of_pixels.mean(dim=(2, 3), keepdim=True), one)[:, :, 0, 0]
    return torch.where(of_means > 0, of_rays / of_means, 1.0).movedim(-1, 0)


def _expected(lengths: Float[Tensor, "row column y x basis"], one: Measurements) -> Float[Tensor, "row column y x c"]:
    """Expected counts at exposure and gain 1."""
    if one.profile is not None:
        known = torch.from_numpy(one.profile).to(lengths).movedim(0, -1)[:, :, None, None]
        lengths = torch.cat([lengths, known.expand(*lengths.shape[:-1], -1)], dim=-1)
    return transmit(lengths.contiguous(), one.transmission)
