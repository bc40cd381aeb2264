"""The least noise that counts allow in averages over voxels: the Cramer-Rao bound of a voxel model.

All voxels and bases are unknown, and neither smoothness nor positivity is assumed. Then the variance of w^T x is at
least w^T F^-1 w, with the Fisher information F = sum_r a_r a_r^T (x) F_r of all voxels, a_r the lengths of ray r in
voxels and F_r the Fisher matrix of its line integrals (Kay 1993, Fundamentals of Statistical Signal Processing I,
theorem 3.2). A method with less noise uses assumptions about the object.

F^-1 w comes from conjugate gradients with the matched projector (Hestenes & Stiefel 1952, doi:10.6028/jres.049.044).
From zero their w^T x only grows towards w^T F^-1 w, so that it is a valid bound after any number of iterations.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.data.measurements import Measurements
from recon.gaussians.fisher import ray_information
from recon.voxel.iterative.likelihood import VIEWS_AT_ONCE, forward, transpose

ITERATIONS = 80  # largest number of iterations; chosen by hand, as bounds converge before
CONVERGED = 5e-4  # no unit; relative growth of all bounds in an iteration at which the iterations end; by hand
SEEN = 1e-6  # no unit; least path of all rays in a voxel over the mean, for the voxel to count as seen

Vectors = Float[np.ndarray, "vector basis z y x"]


@dataclass(frozen=True, eq=False)
class VoxelInformation:
    """Fisher information of the coefficients of all voxels.

    Parameters
    ----------
    rays : Fisher matrix of the line integrals of every ray
    geometry : poses of the views
    grid : grid of the voxels
    """

    rays: Float[np.ndarray, "view row column basis basis"]
    geometry: Geometry
    grid: Grid

    @classmethod
    def of(
        cls, measurements: Measurements, volumes: Float[np.ndarray, "basis z y x"], grid: Grid
    ) -> "VoxelInformation":
        """Compute the information of counts with the noise of a given object.

        Parameters
        ----------
        measurements : the views, at any binning
        volumes : coefficients of the object [1/mm]
        grid : grid of `volumes`

        Returns
        -------
        the information
        """
        lengths = np.moveaxis(forward(volumes.astype(np.float32), measurements.geometry, grid), 0, 1)
        views = range(len(measurements))
        rays = [ray_information(measurements[[i]], lengths[[i]], 0.0)[0].astype(np.float32) for i in views]
        return cls(np.stack(rays), measurements.geometry, grid)

    def times(self, vectors: Vectors) -> Vectors:
        """Multiply vectors by the information matrix.

        Parameters
        ----------
        vectors : volumes of all bases, one set per vector

        Returns
        -------
        the products
        """
        count, bases = vectors.shape[:2]
        flat = vectors.reshape(-1, *self.grid.shape).astype(np.float32)
        out = np.zeros(flat.shape, np.float32)
        for first in range(0, len(self.geometry), VIEWS_AT_ONCE):
            some = slice(first, first + VIEWS_AT_ONCE)
            lengths = forward(flat, self.geometry[some], self.grid)
            lengths = lengths.reshape(count, bases, *lengths.shape[1:])
            ray_gradients = np.einsum("vrcmn,knvrc->kmvrc", self.rays[some], lengths, optimize=True)
            out += transpose(ray_gradients.reshape(-1, *ray_gradients.shape[2:]), self.geometry[some], self.grid)
        return out.reshape(vectors.shape).astype(np.float64)

    @cached_property
    def _roots(self) -> Float[np.ndarray, "basis basis z y x"]:
        """Inverse square roots of the mean Fisher matrix of the rays through each voxel."""
        bases = self.rays.shape[-1]
        images = np.moveaxis(self.rays, (-2, -1), (0, 1)).reshape(bases**2, *self.rays.shape[:3])
        lengths = transpose(np.ones((1, *images.shape[1:]), np.float32), self.geometry, self.grid)
        sums = transpose(images, self.geometry, self.grid)
        overall = self.rays.mean(axis=(0, 1, 2), dtype=np.float64)
        seen = lengths > SEEN * lengths.mean()
        means = np.where(seen, sums / np.where(seen, lengths, 1), overall.reshape(-1, 1, 1, 1))
        values, axes = np.linalg.eigh(np.moveaxis(means, 0, -1).reshape(*self.grid.shape, bases, bases))
        values = np.maximum(values, 1e-9 * values.max())
        return np.einsum("zyxmk,zyxk,zyxnk->mnzyx", axes, values**-0.5, axes)

    @cached_property
    def _ramp(self) -> Float[np.ndarray, "z y x"]:
        """Length of each wave vector [1/mm]; half of the least one for the zero frequency."""
        waves = [np.fft.fftfreq(n, s) for n, s in zip(self.grid.shape, self.grid.spacing, strict=True)]
        ramp = np.sqrt(sum(part**2 for part in np.meshgrid(*waves, indexing="ij")))
        ramp[0, 0, 0] = ramp[ramp > 0].min(initial=1.0) / 2
        return ramp

    def precondition(self, vectors: Vectors) -> Vectors:
        """Multiply vectors by a positive definite approximation of the inverse, which preconditions the iterations.

        The approximation is the ramp of back-projection in whitened voxels, as in Fessler & Booth 1999,
        doi:10.1109/83.760336, with matrices in place of numbers.

        Parameters
        ----------
        vectors : volumes of all bases, one set per vector

        Returns
        -------
        the products
        """
        white = np.einsum("mnzyx,knzyx->kmzyx", self._roots, vectors)
        filtered = np.fft.ifftn(np.fft.fftn(white, axes=(2, 3, 4)) * self._ramp, axes=(2, 3, 4)).real
        return np.einsum("mnzyx,knzyx->kmzyx", self._roots, filtered)


def least_variances(
    information: VoxelInformation,
    weights: Float[np.ndarray, "weight z y x"],
    iterations: int = ITERATIONS,
    converged: float = CONVERGED,
) -> Float[np.ndarray, "weight basis"]:
    """Compute the least variance of unbiased estimates of weighted sums over voxels, for each basis.

    Parameters
    ----------
    information : information of the counts
    weights : weights of the voxels, for instance the indicator of a region over its number of voxels
    iterations : largest number of iterations
    converged : relative growth in an iteration at which they end; the bound is too low by a few times this part

    Returns
    -------
    variances [1/mm^2], times the square of the unit of the weights
    """
    bases = information.rays.shape[-1]
    left = np.einsum("kzyx,mn->kmnzyx", weights, np.eye(bases)).reshape(-1, bases, *weights.shape[1:])
    found = np.zeros(len(left))
    guess = information.precondition(left)
    direction, energy = guess, _inner(left, guess)
    for _ in range(iterations):
        image = information.times(direction)
        step = _ratio(energy, _inner(direction, image))
        grown = step * energy  # what w^T x grows by
        found += grown
        if (grown <= converged * found).all():
            break
        left = left - _each(step) * image
        guess = information.precondition(left)
        before, energy = energy, _inner(left, guess)
        direction = guess + _each(_ratio(energy, before)) * direction
    return found.reshape(len(weights), bases)


def _inner(a: Vectors, b: Vectors) -> Float[np.ndarray, " vector"]:
    return np.einsum("kmzyx,kmzyx->k", a, b)


def _ratio(a: Float[np.ndarray, " vector"], b: Float[np.ndarray, " vector"]) -> Float[np.ndarray, " vector"]:
    """Quotients; 0 where the residual has vanished."""
    return np.divide(a, b, out=np.zeros_like(a), where=b > 0)


def _each(numbers: Float[np.ndarray, " vector"]) -> Float[np.ndarray, "vector 1 1 1 1"]:
    return numbers[:, None, None, None, None]
