"""Image-domain decomposition: each channel is reconstructed by itself, then bases are fitted linearly in every voxel.

The attenuation in a channel is modelled as mu_c = sum_m Q_cm alpha_m, with Q the mean of each basis over the open beam
of the channel. This holds for small attenuation only; the error is beam hardening. It is here for comparison with
methods that know the spectrum.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.inpainting import inpainted
from phantomgen.geometry.voxel_grid import Grid
from recon.data.measurements import Measurements
from recon.data.partial_volume import LEAST_COUNTS
from recon.voxel.method import Iteration, LinearMethod, OnIteration, Volumes, Weights, no_callback


def log_projections(measured: Measurements) -> Float[np.ndarray, "channel view row column"]:
    """Compute the logarithm of open beam over counts.

    Parameters
    ----------
    measured : counts with all channels in all views

    Returns
    -------
    log projections; those of blind pixels are interpolated from their neighbours
    """
    open_beam = measured.exposure[:, :, None, None] * (measured.gains * measured.open_beam)
    logs = np.log(np.maximum(open_beam, LEAST_COUNTS) / np.maximum(measured.counts, LEAST_COUNTS))
    channels = zip(np.moveaxis(logs, 1, 0), measured.gains, strict=True)
    return np.stack([inpainted(images, gains <= 0) for images, gains in channels]).astype(np.float32)


def linear_response(measured: Measurements) -> Float[np.ndarray, "channel basis"]:
    """Compute the mean of each basis over the open beam of each channel, behind the mean bowtie filter.

    Parameters
    ----------
    measured : counts with their spectral model

    Returns
    -------
    Q, the slopes of log projections in the line integrals at zero [no unit]
    """
    bases = len(measured.basis_names)
    fixed = np.zeros(0) if measured.profile is None else measured.profile.mean(axis=(1, 2))
    beam = np.concatenate([np.zeros(bases), fixed])
    return measured.transmission.log_projection_and_slopes(beam)[1][:, :bases]


def reconstruct_channels(
    measured: Measurements,
    weights: Weights | None,
    method: LinearMethod,
    grid: Grid,
    on_iteration: OnIteration = no_callback,
) -> Volumes:
    """Reconstruct one volume per channel and fit the bases in each voxel by least squares.

    Parameters
    ----------
    measured : counts with all channels in all views
    weights : statistical weight of each ray; None if all rays have the same
    method : reconstruction of the channels
    grid : the volume to reconstruct
    on_iteration : called after every iteration of `method`, with volumes of the bases

    Returns
    -------
    volumes of the bases [1/mm]
    """
    solve = np.linalg.pinv(linear_response(measured)).astype(np.float32)

    def bases(volumes: Float[np.ndarray, "channel z y x"]) -> Volumes:
        return np.einsum("mc,czyx->mzyx", solve, volumes)

    def told(iteration: Iteration) -> None:
        on_iteration(replace(iteration, volumes=bases(iteration.volumes)))

    return bases(method.reconstruct(log_projections(measured), weights, measured.geometry, grid, told))
