"""Likelihood by its formula, in float64; gradients by automatic differentiation."""

from jaxtyping import Float
from torch import Tensor

from recon.ops.deviance import deviance
from spectra.ops.transmit import reference


def half_deviance(
    lengths: Float[Tensor, "ray basis_and_part"],
    counts: Float[Tensor, "ray channel"],
    gains: Float[Tensor, "ray channel"],
    columns: Float[Tensor, "basis_and_part node"],
    weights: Float[Tensor, " node"],
    starts: list[int],
    dispersion: float,
) -> Float[Tensor, ""]:
    """Compute half the deviance of rays.

    Parameters
    ----------
    lengths : line integrals of the bases and of the parts of a profile [no unit]
    counts : measured counts
    gains : open-beam counts of each ray over those of the energy nodes, exposure included
    columns, weights, starts : energy nodes as in `recon.ops.arguments.EnergyNodes`
    dispersion : relative model error

    Returns
    -------
    sum over rays and channels
    """
    return deviance(counts, reference.transmit(lengths, columns, weights, starts) * gains, dispersion).sum() / 2
