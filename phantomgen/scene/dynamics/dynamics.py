"""What a scene is at each time: where its objects are, and what its materials consist of."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from phantomgen.scene.dynamics.object_motion import Motions, bends, moved_points, total_motion
from phantomgen.scene.dynamics.signals import Signal
from phantomgen.scene.scene_objects import SceneObjects
from phantomgen.shapes import Placed, Shape
from phantomgen.shapes.surfaces import bent, surface_of
from spectra.errors import InputError

# Instants within the exposure of a view, at the nodes of a Gauss rule, which is exact for motion of degree 5 in time.
_EXPOSURE_NODES = 3


@dataclass(frozen=True)
class Inflow:
    """Material that changes.

    Parameters
    ----------
    material : index of the material, which is what it is at rest
    peak : index of the material that it is where the signal is 1
    signal : name of the signal
    """

    material: int
    peak: int
    signal: str


@dataclass(frozen=True)
class Phases:
    """Division of the views.

    Parameters
    ----------
    count : number of phases
    signal : name of the signal whose cycle is divided; None where the time is
    """

    count: int
    signal: str | None = None


@dataclass(frozen=True, eq=False)
class Dynamics:
    """Time of a scan.

    Parameters
    ----------
    times : of the views [s]
    duration : of the training views [s]
    signals : by name
    motions : of each object; none for one that rests
    inflows : materials that change
    phases : division of the views; None where they are not divided
    exposure : time that a view is averaged over [s]
    """

    times: Float[np.ndarray, " view"]
    duration: float
    signals: Mapping[str, Signal]
    motions: tuple[Motions, ...]
    inflows: tuple[Inflow, ...] = ()
    phases: Phases | None = None
    exposure: float = 0.0

    def at(self, scene: SceneObjects, time: float) -> SceneObjects:
        """Return the objects where they are at a time, and their materials.

        Parameters
        ----------
        scene : the objects at rest
        time : [s]

        Returns
        -------
        the objects

        Raises
        ------
        InputError
            When an object shrinks to nothing, or an inflow lies below zero or above its peak.
        """
        values = {name: float(signal.values(np.array([time]))[0]) for name, signal in self.signals.items()}
        objects = scene.objects
        if any(self.motions):
            objects = tuple(
                (_moved(shape, motions, values), content)
                for (shape, content), motions in zip(scene.objects, self.motions, strict=True)
            )
        return replace(scene, objects=objects, mixing=self._mixing(len(scene.materials), values, time))

    def _mixing(
        self, materials: int, values: Mapping[str, float], time: float
    ) -> Float[np.ndarray, "material material"] | None:
        """State what each material consists of."""
        if not self.inflows:
            return None
        mixing = np.eye(materials)
        for inflow in self.inflows:
            part = values[inflow.signal]
            if not -1e-9 <= part <= 1 + 1e-9:
                raise InputError(
                    f"an inflow follows a signal from 0 to 1, but {inflow.signal!r} is {part:.3g} at {time:.3g} s"
                )
            mixing[inflow.material, inflow.material] = 1 - part
            mixing[inflow.material, inflow.peak] = part
        return mixing

    def instants(self, view: int) -> Float[np.ndarray, " instant"]:
        """Return the instants whose mean, weighted by `weights`, a view shows.

        Parameters
        ----------
        view : number of the view

        Returns
        -------
        times [s]
        """
        if self.exposure == 0:
            return self.times[view : view + 1]
        nodes, _ = np.polynomial.legendre.leggauss(_EXPOSURE_NODES)
        return self.times[view] + nodes * self.exposure / 2

    @property
    def weights(self) -> Float[np.ndarray, " instant"]:
        """Weights of `instants`, whose sum is 1."""
        if self.exposure == 0:
            return np.ones(1)
        return np.polynomial.legendre.leggauss(_EXPOSURE_NODES)[1] / 2

    def by_module(self, modules: int) -> "Dynamics":
        """Return the time of a scan whose views are those of the modules of a curved panel.

        Parameters
        ----------
        modules : of each view

        Returns
        -------
        the time
        """
        return replace(self, times=np.repeat(self.times, modules))

    @property
    def phase_of_view(self) -> Int[np.ndarray, " view"] | None:
        """Phase of each view; None where views are not divided.

        Phases of a cycle are centred at 0, 1 / count, 2 / count ... of it.
        """
        if self.phases is None:
            return None
        return self._position.astype(np.int64) % self.phases.count

    @property
    def _position(self) -> Float[np.ndarray, " view"]:
        """Position of each view in the division, in phases, where phase 0 begins at 0; the time where there is none."""
        if self.phases is None:
            return self.times
        count = self.phases.count
        if self.phases.signal is None:
            return np.clip(self.times / self.duration, 0.0, np.nextafter(1.0, 0.0)) * count
        cycles = self.signals[self.phases.signal].cycles(self.times)
        assert cycles is not None  # refused where the scene is read
        return (cycles * count + 0.5) % count

    def in_order(self, views: Int[np.ndarray, " _view"]) -> Int[np.ndarray, " _view"]:
        """Sort views of one phase by their position in it.

        Parameters
        ----------
        views : numbers of the views

        Returns
        -------
        the same numbers
        """
        return views[np.argsort(self._position[views], kind="stable")]


def _moved(shape: Shape, motions: Motions, values: Mapping[str, float]) -> Shape:
    """An object where it is, in the form that it has."""
    if not motions:
        return shape
    if bends(motions):
        return bent(surface_of(shape), lambda points: moved_points(motions, values, points))
    matrix = total_motion(motions, values)
    return shape if np.array_equal(matrix, np.eye(4)) else Placed(shape, matrix[:3, :3], matrix[:3, 3])
