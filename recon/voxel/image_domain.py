"""Decomposition after reconstruction: each channel by itself, then a linear fit of the bases in every voxel.

The attenuation that a channel sees is taken for a sum over bases, mu_c = sum_m Q_cm alpha_m, with Q the mean of each
basis over the open beam of the channel. That is right for little attenuation only; the rest is beam hardening. Kept for
comparison, as what is usually compared with methods that know the spectrum.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.voxel_grid import Grid
from recon.data.inpainting import inpainted
from recon.data.measurements import Measurements
from recon.voxel.method import Iteration, LinearMethod, OnIteration, Volumes, Weights, unwatched

FEWEST = 0.5  # counts below are raised to this before a logarithm


def log_projections(measured: Measurements) -> Float[np.ndarray, "channel view row column"]:
    """Logarithm of open beam over counts; blind pixels take what their neighbours suggest."""
    open_beam = measured.exposure[:, :, None, None] * (measured.gains * measured.open_beam)
    logs = np.log(np.maximum(open_beam, FEWEST) / np.maximum(measured.counts, FEWEST))
    channels = zip(np.moveaxis(logs, 1, 0), measured.gains, strict=True)
    return np.stack([inpainted(images, gains <= 0) for images, gains in channels]).astype(np.float32)


def linear_response(measured: Measurements) -> Float[np.ndarray, "channel basis"]:
    """Mean of each basis over the open beam of each channel, behind the mean of a bowtie filter."""
    bases = len(measured.basis_names)
    fixed = np.zeros(0) if measured.profile is None else measured.profile.mean(axis=(1, 2))
    beam = np.concatenate([np.zeros(bases), fixed])
    return measured.transmission.log_projection_and_slopes(beam)[1][:, :bases]


def reconstruct_channels(
    measured: Measurements,
    weights: Weights | None,
    method: LinearMethod,
    grid: Grid,
    on_iteration: OnIteration = unwatched,
) -> Volumes:
    """Volumes of the bases [1/mm] from one volume per channel, least squares in each voxel.

    Parameters
    ----------
    measured : counts with all channels in all views
    weights : of each ray
    method : reconstructs the channels
    grid : the volume
    on_iteration : is told of the channels' volumes as they become those of the bases
    """
    solve = np.linalg.pinv(linear_response(measured)).astype(np.float32)

    def bases(volumes: Float[np.ndarray, "channel z y x"]) -> Volumes:
        return np.einsum("mc,czyx->mzyx", solve, volumes)

    def told(iteration: Iteration) -> None:
        on_iteration(replace(iteration, volumes=bases(iteration.volumes)))

    return bases(method.reconstruct(log_projections(measured), weights, measured.geometry, grid, told))
