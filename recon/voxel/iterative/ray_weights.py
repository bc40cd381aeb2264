"""Weights of line integrals for least squares: one matrix for all rays, or one for each ray."""

import numpy as np
from jaxtyping import Float
from scipy.fft import irfft, rfft

from recon.ops.nonnegative_newton import as_matrices
from recon.voxel.method import Images

OUTLIER = 3.0  # standard deviations; larger second differences count as edges; chosen by hand, not measured
_ROUNDS = 5  # iterations of covariance and outliers; chosen by hand, not measured


class UniformWeights:
    """One weight F for all rays; steps of their duals are F times a filter along the rows of the panel.

    A projection followed by its transpose amplifies low frequencies most, so that steps without a filter must be short
    enough for these and are too short for high ones. The ramp of filtered back-projection equalises all frequencies.

    Parameters
    ----------
    weights : the matrix F (basis, basis)
    steps : step length at each frequency of a row [no unit]
    """

    def __init__(self, weights: Float[np.ndarray, "basis basis"], steps: Float[np.ndarray, " frequency"]) -> None:
        self.mean, self.steps = np.asarray(weights, dtype=np.float64), steps.astype(np.float32)

    def proximal(self, duals: Images, images: Images, measured: Images) -> Images:
        """Do a proximal step of the duals q of the functional ``sum_r q_r^T F^-1 q_r / 2 + <q, measured>``.

        Parameters
        ----------
        duals : current duals q
        images : extrapolated projections of the volumes [no unit]
        measured : line integrals to fit [no unit]

        Returns
        -------
        new duals
        """
        columns = duals.shape[-1]
        pushed, kept = (np.asarray(rfft(x, axis=-1)) for x in (_times(self.mean, images - measured), duals))
        moved = (kept + self.steps * pushed) / (1 + self.steps)
        return np.asarray(irfft(moved, n=columns, axis=-1), dtype=np.float32)

    def half_square(self, residual: Images) -> float:
        """Compute ``sum_r residual_r^T F residual_r / 2``.

        Parameters
        ----------
        residual : differences of line integrals [no unit]

        Returns
        -------
        the sum over all rays
        """
        return 0.5 * inner(residual, _times(self.mean, residual))

    def half_inverse_square(self, duals: Images) -> float:
        """Compute ``sum_r q_r^T F^-1 q_r / 2``.

        Parameters
        ----------
        duals : duals q

        Returns
        -------
        the sum over all rays
        """
        return 0.5 * inner(duals, _times(np.linalg.inv(self.mean), duals))


class RayWeights:
    """One weight F_r per ray; steps of the duals are `steps` times the mean weight.

    Parameters
    ----------
    weights : upper triangle of F_r, row by row (pair, view, row, column)
    steps : step length of each ray [no unit]
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

    def proximal(self, duals: Images, images: Images, measured: Images) -> Images:
        """Do a proximal step of the duals q of the functional ``sum_r q_r^T F_r^-1 q_r / 2 + <q, measured>``.

        Parameters
        ----------
        duals : current duals q
        images : extrapolated projections of the volumes [no unit]
        measured : line integrals to fit [no unit]

        Returns
        -------
        new duals
        """
        moved = duals + self.steps * _times(self.mean, images - measured)
        return np.moveaxis(np.einsum("vrcmn,nvrc->vrcm", self._shrink, moved, optimize=True), -1, 0)

    def half_square(self, residual: Images) -> float:
        """Compute ``sum_r residual_r^T F_r residual_r / 2``.

        Parameters
        ----------
        residual : differences of line integrals [no unit]

        Returns
        -------
        the sum over all rays
        """
        return 0.5 * inner(residual, np.einsum("vrcmn,nvrc->mvrc", self.each, residual, optimize=True))

    def half_inverse_square(self, duals: Images) -> float:
        """Compute ``sum_r q_r^T F_r^-1 q_r / 2``.

        Parameters
        ----------
        duals : duals q

        Returns
        -------
        the sum over all rays
        """
        rows = np.moveaxis(duals, 0, -1)[..., None].astype(np.float64)
        solved = np.linalg.pinv(self.each.astype(np.float64), rcond=1e-10, hermitian=True) @ rows
        return 0.5 * float(np.vdot(rows, solved))


def inner(one: Float[np.ndarray, "..."], other: Float[np.ndarray, "..."]) -> float:
    """Compute an inner product, summed in float64, as a duality gap is a small difference of large sums.

    Parameters
    ----------
    one, other : arrays of the same shape

    Returns
    -------
    the sum of the products
    """
    return float(np.sum(one * other, dtype=np.float64))


def _times(matrix: Float[np.ndarray, "basis basis"], images: Images) -> Images:
    return np.einsum("mn,nvrc->mvrc", matrix.astype(np.float32), images)


def noise_information(images: Images) -> Float[np.ndarray, "basis basis"]:
    """Estimate the inverse covariance of the noise of images, from second differences along rows except at edges.

    Second differences of noise without correlation between neighbours have six times its variance.

    Parameters
    ----------
    images : one image per basis and view [no unit]

    Returns
    -------
    inverse covariance between the bases
    """
    second = np.diff(images.astype(np.float64), n=2, axis=-1).reshape(len(images), -1)
    covariance = np.diag(np.median(np.abs(second), axis=1) ** 2 * (1.4826**2) + 1e-20)
    for _ in range(_ROUNDS):
        distance = np.einsum("mi,mi->i", second, np.linalg.solve(covariance, second))
        kept = second[:, distance < OUTLIER**2 * len(images)]
        covariance = kept @ kept.T / kept.shape[1] + 1e-20 * np.eye(len(images))
    return np.linalg.inv(covariance / 6)
