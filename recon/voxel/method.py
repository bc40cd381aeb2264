"""What a classical method is: a value with hyper-parameters that turns data into volumes."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.data.measurements import Measurements

Volumes: TypeAlias = Float[np.ndarray, "basis z y x"]
Images: TypeAlias = Float[np.ndarray, "basis view row column"]
Weights: TypeAlias = Float[np.ndarray, "view row column"]
ViewModel: TypeAlias = Callable[[Geometry], Float[np.ndarray, "channel view row column"]]  # log projections from there


@dataclass(frozen=True, eq=False)
class Iteration:
    """What a callback is told after every iteration.

    Parameters
    ----------
    done, total : iterations so far and in all
    residual : what is left of the data, as a method measures it: norm of residuals, deviance per count, or duality gap
        over the objective; None where it was not looked at
    volumes : the state [1/mm]; it changes in place, so copy what is to be kept; empty for a method without volumes
    grid : of the volumes where it is another one than was asked for, as in coarse passes
    views : the state of a method without volumes; it changes in place
    """

    done: int
    total: int
    residual: float | None
    volumes: Volumes
    grid: Grid | None = None
    views: ViewModel | None = None


OnIteration: TypeAlias = Callable[[Iteration], None]


def unwatched(_: Iteration) -> None:
    """A callback that does nothing."""


class Report:
    """Counts iterations, and tells a callback."""

    def __init__(self, on_iteration: OnIteration, total: int) -> None:
        self._tell, self._total, self._done = on_iteration, total, 0

    def __call__(self, volumes: Volumes, residual: float | None, grid: Grid | None = None) -> None:
        """One more is done."""
        self._done += 1
        self._tell(Iteration(self._done, self._total, residual, volumes, grid))


@runtime_checkable
class LinearMethod(Protocol):
    """Volumes from line integrals; bases or channels do not know of each other."""

    @property
    def name(self) -> str:
        """What ``--method`` calls it."""
        ...

    def reconstruct(
        self,
        line_integrals: Images,
        weights: Weights | None,
        geometry: Geometry,
        grid: Grid,
        on_iteration: OnIteration = unwatched,
    ) -> Volumes:
        """Volumes [1/mm] of line integrals [no unit].

        Parameters
        ----------
        line_integrals : one image per basis and view
        weights : how much each ray counts, 0 for those that were not measured; all alike if None
        geometry : poses of the views
        grid : the volume to reconstruct
        on_iteration : called after every iteration
        """
        ...


@runtime_checkable
class CountsMethod(Protocol):
    """Volumes of all bases at once, from counts."""

    @property
    def name(self) -> str:
        """What ``--method`` calls it."""
        ...

    def reconstruct_counts(
        self, measurements: Measurements, grid: Grid, on_iteration: OnIteration = unwatched
    ) -> Volumes:
        """Volumes [1/mm] of the bases of `measurements`."""
        ...


@runtime_checkable
class ViewMethod(Protocol):
    """Log projections in views that were not taken; there is no volume."""

    @property
    def name(self) -> str:
        """What ``--method`` calls it."""
        ...

    def learn_views(
        self,
        log_projections: Images,
        weights: Weights | None,
        geometry: Geometry,
        grid: Grid,
        on_iteration: OnIteration = unwatched,
    ) -> ViewModel:
        """What predicts log projections of all channels, from those of the given views.

        Parameters
        ----------
        log_projections : one image per channel and view
        weights : how much each ray counts, 0 for those that were not measured; all alike if None
        geometry : poses of the views
        grid : where the object is
        on_iteration : called after every iteration
        """
        ...


Method: TypeAlias = LinearMethod | CountsMethod
