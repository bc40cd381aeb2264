"""Simultaneous iterative reconstruction technique: gradient descent scaled by row and column sums.

With A the matrix of path lengths, R and C the inverses of its row and column sums, and w the weights of the rays::

    x <- x + relaxation C A^T R w (b - A x)

References
----------
Gilbert 1972, doi:10.1016/0022-5193(72)90180-4; in this form Gregor & Benson 2008, doi:10.1109/TMI.2008.923696.
"""

from collections.abc import Iterator
from dataclasses import dataclass

from recon.voxel.iterative.iteration import IterativeMethod, LinearSystem, UpdateRule, weighted_norm
from recon.voxel.method import Volumes
from recon.voxel.projector_pair import inverse_or_zero


@dataclass(frozen=True)
class Sirt(IterativeMethod):
    """SIRT as a method.

    The residual of a pass is ||(R w)^1/2 (b - A x)|| before it, over that of x = 0.

    Parameters
    ----------
    iterations : passes over all views; 80 by `benchmarks.reconstruction.comparison_methods`, as noise grows beyond
    relaxation : length of a step [no unit]; SIRT converges below 2, and fastest near it
    non_negative : whether negative values become 0 after each step
    """

    iterations: int = 80
    relaxation: float = 1.9
    non_negative: bool = True

    @property
    def name(self) -> str:
        """Name of the method, as in ``--method``."""
        return "sirt"

    def update_rule(self, system: LinearSystem) -> UpdateRule:
        """Prepare the passes over the views.

        Parameters
        ----------
        system : line integrals to explain, with their weights and projector

        Returns
        -------
        one pass, which is one step with all views
        """
        projector = system.projector
        column_scales = self.relaxation * inverse_or_zero(projector.transpose(system.ray_weights[None])[0])

        def update(volumes: Volumes, _: int) -> Iterator[float]:
            residual = system.line_integrals - projector.project(volumes)
            relative = weighted_norm(residual, system.row_scales) / system.norm
            volumes += column_scales * projector.transpose(residual * system.row_scales)
            yield relative

        return update
