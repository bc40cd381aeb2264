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
    """Half the deviance of rays, gains including the exposure."""
    return deviance(counts, reference.transmit(lengths, columns, weights, starts) * gains, dispersion).sum() / 2
