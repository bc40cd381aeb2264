"""Weights of line integrals: one matrix for all rays or one for each, and what least squares does with them."""

import numpy as np
from jaxtyping import Float

from recon.ops.positive_step import as_matrices
from spectra.errors import InputError

Images = Float[np.ndarray, "basis view row column"]
OUTLIER = 3.0  # standard deviations; larger second differences are edges
_ROUNDS = 5


class RayWeights:
    """Weights F_r, and the steps of the duals of rays, which are `steps` times the mean weight.

    Parameters
    ----------
    weights : (basis, basis), or (pair, view, row, column) with upper triangles row by row
    steps : of each ray, without unit
    """

    def __init__(self, weights: Float[np.ndarray, "..."], steps: Float[np.ndarray, "view row column"]) -> None:
        if weights.ndim not in (2, 4):
            raise InputError(
                "weights must be one matrix (basis, basis) or a triangle per ray (pair, view, row, column), "
                f"got shape {weights.shape}"
            )
        self.steps = steps.astype(np.float32)
        self.each = as_matrices(weights).astype(np.float32) if weights.ndim == 4 else None
        whole = weights if self.each is None else self.each.mean(axis=(0, 1, 2), dtype=np.float64)
        self.mean = np.asarray(whole, dtype=np.float64)
        if self.each is not None:
            wide = self.each + self.steps[..., None, None] * self.mean
            ridge = 1e-6 * np.trace(self.mean) * np.eye(len(self.mean))
            self._shrink = (self.each @ np.linalg.inv(wide + ridge)).astype(np.float32)

    def toward(self, duals: Images, images: Images, measured: Images) -> Images:
        """Proximal step of the duals q: the minimum of half their inverse square plus <q, measured>."""
        moved = duals + self.steps * self._times_mean(images - measured)
        if self.each is None:
            return moved / (1 + self.steps)
        return np.moveaxis(np.einsum("vrcmn,nvrc->vrcm", self._shrink, moved, optimize=True), -1, 0)

    def half_square(self, residual: Images) -> float:
        """``sum_r residual_r^T F_r residual_r / 2``."""
        if self.each is None:
            return 0.5 * float(np.vdot(residual, self._times_mean(residual)))
        return 0.5 * float(np.einsum("mvrc,vrcmn,nvrc->", residual, self.each, residual, optimize=True))

    def half_inverse_square(self, duals: Images) -> float:
        """``sum_r q_r^T F_r^-1 q_r / 2``."""
        if self.each is None:
            solved = np.einsum("mn,nvrc->mvrc", np.linalg.inv(self.mean), duals)
            return 0.5 * float(np.vdot(duals, solved))
        rows = np.moveaxis(duals, 0, -1)[..., None].astype(np.float64)
        solved = np.linalg.pinv(self.each.astype(np.float64), rcond=1e-10, hermitian=True) @ rows
        return 0.5 * float(np.vdot(rows, solved))

    def _times_mean(self, images: Images) -> Images:
        return np.einsum("mn,nvrc->mvrc", self.mean.astype(np.float32), images)


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
