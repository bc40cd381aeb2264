"""Interfaces of reconstruction methods: values with hyper-parameters that turn data into volumes or views."""

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
ViewModel: TypeAlias = Callable[[Geometry], Float[np.ndarray, "channel view row column"]]  # log projections at poses


@dataclass(frozen=True, eq=False)
class Iteration:
    """State of a method after an iteration, for a callback.

    Parameters
    ----------
    done, total : number of iterations so far and in all
    residual : disagreement with the data in the measure of the method: relative norm of residuals, deviance per count,
        or duality gap over the objective; None where the method has not computed it
    volumes : current volumes [1/mm]; they change in place, so copy what shall be kept; empty for a method without
        volumes
    grid : grid of the volumes where it differs from the requested one, as in coarse passes
    views : current model of a method without volumes; it changes in place
    """

    done: int
    total: int
    residual: float | None
    volumes: Volumes
    grid: Grid | None = None
    views: ViewModel | None = None


OnIteration: TypeAlias = Callable[[Iteration], None]


def no_callback(_: Iteration) -> None:
    """Do nothing after an iteration.

    Parameters
    ----------
    _ : the iteration
    """


class Report:
    """Counter of iterations that calls a callback.

    Parameters
    ----------
    on_iteration : callback to call
    total : number of iterations in all
    """

    def __init__(self, on_iteration: OnIteration, total: int) -> None:
        self._tell, self._total, self._done = on_iteration, total, 0

    def expect_more(self, iterations: int) -> None:
        """Add to the number of iterations that the callback is told.

        Parameters
        ----------
        iterations : how many more there will be
        """
        self._total += iterations

    def __call__(self, volumes: Volumes, residual: float | None, grid: Grid | None = None) -> None:
        """Count one more iteration and call the callback."""
        self._done += 1
        self._tell(Iteration(self._done, self._total, residual, volumes, grid))


@runtime_checkable
class LinearMethod(Protocol):
    """A method that reconstructs volumes from line integrals, each basis or channel by itself."""

    @property
    def name(self) -> str:
        """Name of the method, as in ``--method``."""
        ...

    def reconstruct(
        self,
        line_integrals: Images,
        weights: Weights | None,
        geometry: Geometry,
        grid: Grid,
        on_iteration: OnIteration = no_callback,
    ) -> Volumes:
        """Reconstruct volumes from line integrals.

        Parameters
        ----------
        line_integrals : one image per basis and view [no unit]
        weights : statistical weight of each ray, 0 for rays that were not measured; None if all rays have the same
        geometry : poses of the views
        grid : the volume to reconstruct
        on_iteration : called after every iteration

        Returns
        -------
        volumes of the bases [1/mm]
        """
        ...


@runtime_checkable
class CountsMethod(Protocol):
    """A method that reconstructs the volumes of all bases together, from counts."""

    @property
    def name(self) -> str:
        """Name of the method, as in ``--method``."""
        ...

    def reconstruct_counts(
        self, measurements: Measurements, grid: Grid, on_iteration: OnIteration = no_callback
    ) -> Volumes:
        """Reconstruct volumes from counts.

        Parameters
        ----------
        measurements : views to use, unbinned
        grid : the volume to reconstruct
        on_iteration : called after every iteration

        Returns
        -------
        volumes of the bases of `measurements` [1/mm]
        """
        ...


@runtime_checkable
class ViewMethod(Protocol):
    """A method that predicts log projections in views that were not measured, without a volume."""

    @property
    def name(self) -> str:
        """Name of the method, as in ``--method``."""
        ...

    def learn_views(
        self,
        log_projections: Images,
        weights: Weights | None,
        geometry: Geometry,
        grid: Grid,
        on_iteration: OnIteration = no_callback,
    ) -> ViewModel:
        """Train a model of the log projections of all channels on the given views.

        Parameters
        ----------
        log_projections : one image per channel and view
        weights : statistical weight of each ray, 0 for rays that were not measured; None if all rays have the same
        geometry : poses of the views
        grid : the box that holds the object
        on_iteration : called after every iteration

        Returns
        -------
        a function from poses to log projections
        """
        ...


Method: TypeAlias = LinearMethod | CountsMethod
