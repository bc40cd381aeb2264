"""A sample that moves between views, as a rigid body: x becomes R x + s, with a rotation R about the isocentre.

Time runs from 0 at the first view to 1 at the end of the scan; within a view the sample stands still. The truth of a
dataset is the sample at rest, where its displacement is zero: that is its pose at time 0 of a drift and of a random
walk, and the middle of a sinusoid. A sample that moves is a source and a panel that move the other way.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from phantomgen.effects.random_streams import Stream, generator
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.rotation import rotation_matrix

Triple = tuple[float, float, float]
Times = Float[np.ndarray, " view"]
_NONE: Triple = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Motion(ABC):
    """Rigid motion of the sample.

    Parameters
    ----------
    shift : along x, y and z [mm]
    rotation : about the fixed x, then y, then z axis [rad]
    """

    shift: Triple = _NONE
    rotation: Triple = _NONE

    @abstractmethod
    def amplitudes(self, times: Times, steps: int, seed: int) -> Float[np.ndarray, "view 6"]:
        """Compute the part of each shift and of each rotation that is reached at `times`.

        Parameters
        ----------
        times : of the views, 0 to 1
        steps : number of training views, at equal steps of time
        seed : of random motion

        Returns
        -------
        parts, (view, 6)
        """

    def poses(self, times: Times, steps: int, seed: int) -> Float[np.ndarray, "view 4 4"]:
        """Compute the matrix of each view from points of the sample at rest to their places.

        Parameters
        ----------
        times : of the views, 0 to 1
        steps : number of training views, which stand at equal steps of time
        seed : of random motion

        Returns
        -------
        matrices [mm], (view, 4, 4)
        """
        parts = self.amplitudes(times, steps, seed) * np.array([*self.shift, *self.rotation])
        poses = np.tile(np.eye(4), (len(times), 1, 1))
        poses[:, :3, 3] = parts[:, :3]
        for pose, angles in zip(poses, parts[:, 3:], strict=True):
            pose[:3, :3] = rotation_matrix(tuple(angles))
        return poses


@dataclass(frozen=True)
class Drift(Motion):
    """Uniform motion: shift and rotation are reached at the end of the scan."""

    def amplitudes(self, times: Times, steps: int, seed: int) -> Float[np.ndarray, "view 6"]:
        """Return the time as amplitude of all six.

        Parameters
        ----------
        times : of the views, 0 to 1
        steps : not used
        seed : not used

        Returns
        -------
        parts, (view, 6)
        """
        return np.repeat(times[:, None], 6, axis=1)


@dataclass(frozen=True)
class Sinusoid(Motion):
    """Periodic motion, such as breathing or the wobble of a rotation axis: sin(2 pi periods time + phase).

    Parameters
    ----------
    periods : in the scan
    phase : at its beginning [rad]
    """

    periods: float = 1.0
    phase: float = 0.0

    def amplitudes(self, times: Times, steps: int, seed: int) -> Float[np.ndarray, "view 6"]:
        """Compute one sine for all six amplitudes.

        Parameters
        ----------
        times : of the views, 0 to 1
        steps : not used
        seed : not used

        Returns
        -------
        parts, (view, 6)
        """
        return np.repeat(np.sin(2 * np.pi * self.periods * times + self.phase)[:, None], 6, axis=1)


@dataclass(frozen=True)
class RandomWalk(Motion):
    """Brownian motion: shift and rotation are the standard deviations of a step from one training view to the next."""

    def amplitudes(self, times: Times, steps: int, seed: int) -> Float[np.ndarray, "view 6"]:
        """Add independent normal numbers in the order of time, one set per view, of variance steps x time.

        Parameters
        ----------
        times : of the views, 0 to 1
        steps : number of training views, at equal steps of time
        seed : of the random numbers

        Returns
        -------
        sums, (view, 6)
        """
        order = np.argsort(times, kind="stable")
        drawn = np.array([generator(seed, Stream.MOTION, view, 0).standard_normal(6) for view in range(len(times))])
        waits = np.diff(times[order], prepend=0.0) * steps
        walked = np.empty((len(times), 6))
        walked[order] = np.cumsum(np.sqrt(waits)[:, None] * drawn[order], axis=0)
        return walked


def seen_from_sample(geometry: Geometry, poses: Float[np.ndarray, "view 4 4"]) -> Geometry:
    """Compute source and panel of each view in the frame of the sample, where they move the opposite way.

    Parameters
    ----------
    geometry : poses in the frame of the room
    poses : matrices of the sample's poses [mm], (view, 4, 4)

    Returns
    -------
    poses in the frame of the sample
    """
    back = np.swapaxes(poses[:, :3, :3], 1, 2)
    return geometry.moved(back, -np.einsum("vij,vj->vi", back, poses[:, :3, 3]))
