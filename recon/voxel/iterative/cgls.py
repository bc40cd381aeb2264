"""Conjugate gradients for least squares, min ||w^1/2 (A x - b)||, each basis by itself.

Noise grows with the iterations, so their number is what regularises.

References
----------
Hestenes & Stiefel 1952, doi:10.6028/jres.049.044, in the form of Bjorck 1996, doi:10.1137/1.9781611971484, algorithm
7.4.1.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from recon.voxel.iterative.iteration import IterativeMethod, LinearSystem, UpdateRule
from recon.voxel.method import Volumes


@dataclass(frozen=True)
class Cgls(IterativeMethod):
    """CGLS as a method; values may be negative.

    The residual of an iteration is ||w^1/2 (b - A x)|| after it, over ||w^1/2 b||.

    Parameters
    ----------
    iterations : passes over all views; 12 by `benchmarks.reconstruction.comparison_methods`, as noise grows beyond
    """

    iterations: int = 12

    @property
    def name(self) -> str:
        """Name of the method, as in ``--method``."""
        return "cgls"

    def update_rule(self, system: LinearSystem) -> UpdateRule:
        """Prepare the iterations.

        Parameters
        ----------
        system : line integrals to explain, with their weights and projector

        Returns
        -------
        one iteration, which is one step along a conjugate direction
        """
        projector = system.projector
        root = np.float32(1) if system.weights is None else np.sqrt(system.weights).astype(np.float32)
        residual = (system.line_integrals * root).astype(np.float32)
        whole = _squares(residual).sum()
        direction = projector.transpose(residual * root)
        steepness = _squares(direction)

        def update(volumes: Volumes, _: int) -> Iterator[float]:
            nonlocal direction, steepness
            image = projector.project(direction) * root
            step = _ratio(steepness, _squares(image))
            volumes += step * direction
            np.subtract(residual, step * image, out=residual)
            gradient = projector.transpose(residual * root)
            before, steepness = steepness, _squares(gradient)
            direction *= _ratio(steepness, before)
            direction += gradient
            yield float(np.sqrt(_squares(residual).sum() / whole)) if whole > 0 else 0.0

        return update


def _squares(arrays: Float[np.ndarray, "basis a b c"]) -> Float[np.ndarray, " basis"]:
    """Sum of squares of each basis, in float64."""
    return np.array([np.sum(np.square(array, dtype=np.float64)) for array in arrays])


def _ratio(a: Float[np.ndarray, " basis"], b: Float[np.ndarray, " basis"]) -> Float[np.ndarray, "basis 1 1 1"]:
    """Quotient of each basis; 0 where the residual has vanished."""
    return np.divide(a, b, out=np.zeros_like(a), where=b > 0).astype(np.float32)[:, None, None, None]
