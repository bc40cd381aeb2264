"""Simultaneous algebraic reconstruction technique, with ordered subsets of the views.

A step is that of SIRT with a subset s of the views, and the row and column sums of its part of the matrix::

    x <- x + relaxation C_s A_s^T R_s w_s (b_s - A_s x)

One view per subset is SART (Andersen & Kak 1984, doi:10.1016/0161-7346(84)90008-7), several are OS-SART (Wang & Jiang
2004, doi:10.1137/S1064827502400679).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from recon.voxel.iterative.iteration import IterativeMethod, LinearSystem, UpdateRule, weighted_norm
from recon.voxel.method import Volumes
from recon.voxel.projector_pair import inverse_or_zero

# subsets; of more views than this several share a subset, unless `Sart.subsets` says otherwise; chosen by hand, not
# measured
MOST_SUBSETS = 90


@dataclass(frozen=True)
class Sart(IterativeMethod):
    """OS-SART as a method.

    The residual of a pass is ||(R w)^1/2 (b - A x)||, each subset before its step, over that of x = 0. Settings were
    compared by `benchmarks.reconstruction.comparison_methods` (`docs/reference/benchmarks/voxel_methods.md`).

    Parameters
    ----------
    iterations : passes over all views
    subsets : parts into which the views are divided: the number of views is SART, 1 is SIRT; None is SART up to
        `MOST_SUBSETS` views
    relaxation : length of a step in the first pass [no unit]
    decay : length of a step over that in the pass before [no unit]
    non_negative : whether negative values become 0 after each step
    """

    iterations: int = 4
    subsets: int | None = None
    relaxation: float = 1.0
    decay: float = 0.7
    non_negative: bool = True

    @property
    def name(self) -> str:
        """Name of the method, as in ``--method``."""
        return "sart"

    def update_rule(self, system: LinearSystem) -> UpdateRule:
        """Prepare the passes over the views.

        Parameters
        ----------
        system : line integrals to explain, with their weights and projector

        Returns
        -------
        one pass, which is one step with each subset of the views
        """
        projector, rows, weights = system.projector, system.row_scales, system.ray_weights
        subsets = ordered_subsets(len(rows), self.subsets or MOST_SUBSETS)

        def update(volumes: Volumes, done: int) -> Iterator[float]:
            square = 0.0
            for views in subsets:
                residual = system.line_integrals[:, views] - projector.project(volumes, views)
                square += weighted_norm(residual, rows[views]) ** 2
                both = np.concatenate([residual * rows[views], weights[None, views]])  # one pass for step and scale
                *steps, column_sums = projector.transpose(both, views)
                volumes += self.relaxation * self.decay ** (done - 1) * inverse_or_zero(column_sums) * np.stack(steps)
                yield float(np.sqrt(square)) / system.norm

        return update


def ordered_subsets(views: int, count: int) -> list[np.ndarray]:
    """Divide views into evenly spread subsets, in an order of steps near the golden section around the orbit.

    The step is the one nearest to 0.382 of the subsets; `recon.data.view_subsets.golden_section_order` takes the next
    longer one, which is another step for 38 of 100 numbers of subsets.

    Parameters
    ----------
    views : number of views
    count : number of subsets, at most one per view

    Returns
    -------
    indices of the views of each subset
    """
    count = min(count, views)
    wanted = max(round(0.382 * count), 1)
    stride = min((s for s in range(1, count + 1) if np.gcd(s, count) == 1), key=lambda s: abs(s - wanted))
    return [np.arange(i * stride % count, views, count) for i in range(count)]
