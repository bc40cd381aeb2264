"""Likelihood: how well line integrals explain counts, with gradient and information, in one pass over the rays."""

import numpy as np
from jaxtyping import Float

from recon.ops.likelihood import cpu
from spectra.errors import InputError
from spectra.threads import run_parallel
from spectra.transmission import Transmission

BLOCK = 64  # rays that go through the energy nodes together
LEAST = 1e-12  # counts; a channel that expects fewer has no say, as in `recon.ops.deviance.deviance`


def likelihood(
    lengths: Float[np.ndarray, "basis view row column"],
    counts: Float[np.ndarray, "view channel row column"],
    gains: Float[np.ndarray, "channel row column"],
    exposure: Float[np.ndarray, "view channel"],
    transmission: Transmission,
    dispersion: float,
    profile: Float[np.ndarray, "part row column"] | None = None,
    information: bool = False,
    shares: Float[np.ndarray, "view channel row column"] | None = None,
) -> tuple[
    Float[np.ndarray, " view"],
    Float[np.ndarray, "basis view row column"],
    Float[np.ndarray, "pair view row column"] | None,
]:
    """Deviance of each view, the gradient of half of it, and curvatures of the rays, each times the rays' shares.

    The variance of counts Y is Y + (dispersion Y)^2. A channel whose gain or exposure is 0 has no say. Curvatures are
    Fisher matrices where counts are as expected; where more arrive, as behind metal that is too thick in the model,
    they are as sharp as those of what arrives, so that steps by their inverse stay bounded.

    Parameters
    ----------
    lengths : line integrals of every basis [no unit]
    counts, gains, exposure, profile, shares : as `recon.data.measurements.Measurements` keeps them
    transmission : columns are the bases, and after them the parts of `profile`
    dispersion : relative model error; 0 for Poisson counts
    information : whether curvatures are wanted

    Returns
    -------
    sum of `recon.ops.deviance.deviance` over each view; derivative of half of it in the line integrals; (J / Y)^T
    diag(M / (1 + dispersion^2 M)) (J / Y) with M the larger of y and Y, the upper triangle row by row, or None

    Raises
    ------
    InputError
        When line integrals, counts and columns do not belong together.
    """
    views, channels, rows, columns = counts.shape
    parts = 0 if profile is None else len(profile)
    bases, pixels = len(transmission.columns) - parts, rows * columns
    if lengths.shape != (bases, views, rows, columns):
        expected = (bases, views, rows, columns)
        raise InputError(f"line integrals must be (basis, view, row, column), {expected}, got {lengths.shape}")
    lengths = np.ascontiguousarray(lengths, np.float32).reshape(bases, views, pixels)
    known = np.zeros((0, pixels), np.float32)
    if profile is not None:
        known = np.ascontiguousarray(profile, np.float32).reshape(parts, pixels)
    gains = np.ascontiguousarray(gains, np.float32).reshape(channels, pixels)
    counts = np.ascontiguousarray(counts, np.float32).reshape(views, channels, pixels)
    parts_of_counts = np.zeros((0, channels, pixels), np.float32)
    if shares is not None:
        parts_of_counts = np.ascontiguousarray(shares, np.float32).reshape(views, channels, pixels)
    exposure = np.ascontiguousarray(exposure, np.float64)
    gradient = np.empty((bases, views, pixels), np.float32)
    fisher = np.empty((bases * (bases + 1) // 2 if information else 0, views, pixels), np.float32)
    model = transmission

    def one_view(v: int) -> float:
        room = np.empty((2 + bases, BLOCK))
        return cpu.likelihood(
            lengths, known, counts, parts_of_counts, gains, exposure, v, model.columns, model.weights, model.starts,
            float(dispersion), LEAST, room, gradient, fisher,
        )  # fmt: skip

    deviances = np.array(list(run_parallel(one_view, range(views))), dtype=np.float64)
    shape = (views, rows, columns)
    return deviances, gradient.reshape(bases, *shape), fisher.reshape(-1, *shape) if information else None
