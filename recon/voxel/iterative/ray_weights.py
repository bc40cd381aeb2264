"""Weights of line integrals: one matrix for all rays or one for each, and what least squares does with them."""

import numpy as np
from jaxtyping import Float
from scipy.fft import irfft, rfft

from recon.ops.nonnegative_newton import as_matrices

Images = Float[np.ndarray, "basis view row column"]
OUTLIER = 3.0  # standard deviations; larger second differences are edges
_ROUNDS = 5


class UniformWeights:
    """One weight F for all rays, and steps of their duals of F times a filter along the rows of the panel.

    What a projection and its transpose do to a wave of a volume falls with its frequency, and so do steps without a
    filter that fit the lowest one. The ramp of filtered back-projection makes all frequencies alike.

    Parameters
    ----------
    weights : (basis, basis)
    steps : of each frequency of a row, without unit
    """

    def __init__(self, weights: Float[np.ndarray, "basis basis"], steps: Float[np.ndarray, " frequency"]) -> None:
        self.mean, self.steps = np.asarray(weights, dtype=np.float64), steps.astype(np.float32)

    def toward(self, duals: Images, images: Images, measured: Images) -> Images:
        """Proximal step of the duals q: the minimum of half their inverse square plus <q, measured>."""
        columns = duals.shape[-1]
        pushed, kept = (np.asarray(rfft(x, axis=-1)) for x in (_times(self.mean, images - measured), duals))
        moved = (kept + self.steps * pushed) / (1 + self.steps)
        return np.asarray(irfft(moved, n=columns, axis=-1), dtype=np.float32)

    def half_square(self, residual: Images) -> float:
        """``sum_r residual_r^T F residual_r / 2``."""
        return 0.5 * inner(residual, _times(self.mean, residual))

    def half_inverse_square(self, duals: Images) -> float:
        """``sum_r q_r^T F^-1 q_r / 2``."""
        return 0.5 * inner(duals, _times(np.linalg.inv(self.mean), duals))


class RayWeights:
    """Weights F_r, and the steps of the duals of rays, which are `steps` times the mean weight.

    Parameters
    ----------
    weights : (pair, view, row, column) with upper triangles row by row
    steps : of each ray, without unit
    """

    def __init__(
        self, weights: Float[np.ndarray, "pair view row column"], steps: Float[np.ndarray, "view row column"]
    ) -> None:
        self.steps = steps.astype(np.float32)
        self.each = as_matrices(weights).astype(np.float32)
        self.mean = self.each.mean(axis=(0, 1, 2), dtype=np.float64)
        wide = self.each + self.steps[..., None, None] * self.mean
        ridge = 1e-6 * np.trace(self.mean) * np.eye(len(self.mean))
        self._shrink = (self.each @ np.linalg.inv(wide + ridge)).astype(np.float32)

    def toward(self, duals: Images, images: Images, measured: Images) -> Images:
        """Proximal step of the duals q: the minimum of half their inverse square plus <q, measured>."""
        moved = duals + self.steps * _times(self.mean, images - measured)
        return np.moveaxis(np.einsum("vrcmn,nvrc->vrcm", self._shrink, moved, optimize=True), -1, 0)

    def half_square(self, residual: Images) -> float:
        """``sum_r residual_r^T F_r residual_r / 2``."""
        return 0.5 * inner(residual, np.einsum("vrcmn,nvrc->mvrc", self.each, residual, optimize=True))

    def half_inverse_square(self, duals: Images) -> float:
        """``sum_r q_r^T F_r^-1 q_r / 2``."""
        rows = np.moveaxis(duals, 0, -1)[..., None].astype(np.float64)
        solved = np.linalg.pinv(self.each.astype(np.float64), rcond=1e-10, hermitian=True) @ rows
        return 0.5 * float(np.vdot(rows, solved))


def inner(one: Float[np.ndarray, "..."], other: Float[np.ndarray, "..."]) -> float:
    """Inner product, summed in float64: a duality gap is a small difference of large sums."""
    return float(np.sum(one * other, dtype=np.float64))


def _times(matrix: Float[np.ndarray, "basis basis"], images: Images) -> Images:
    return np.einsum("mn,nvrc->mvrc", matrix.astype(np.float32), images)


def noise_information(images: Images) -> Float[np.ndarray, "basis basis"]:
    """Inverse covariance of the noise of images, from second differences along rows without those at edges.

    Noise without correlation between neighbours makes second differences of six times its variance.
    """
    second = np.diff(images.astype(np.float64), n=2, axis=-1).reshape(len(images), -1)
    covariance = np.diag(np.median(np.abs(second), axis=1) ** 2 * (1.4826**2) + 1e-20)
    for _ in range(_ROUNDS):
        distance = np.einsum("mi,mi->i", second, np.linalg.solve(covariance, second))
        kept = second[:, distance < OUTLIER**2 * len(images)]
        covariance = kept @ kept.T / kept.shape[1] + 1e-20 * np.eye(len(images))
    return np.linalg.inv(covariance / 6)
