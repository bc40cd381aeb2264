"""Choice of the rays of a step, and of the points on them."""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.voxel.method import Images, Weights
from recon.voxel.projector_pair import ProjectorPair

RayNumbers: TypeAlias = Int[np.ndarray, " ray"]

WINDOW = 8  # pixels; edge of the windows of a view that are sampled as a whole; our choice
FOREGROUND = 0.05  # part of the largest image value above which a ray is taken to meet the object; our choice


@dataclass(frozen=True, eq=False)
class Points:
    """Points on some rays.

    Parameters
    ----------
    places : positions in the box of the grid, -1 to 1 (x, y, z)
    steps : length of ray that each point represents [mm]
    """

    places: Float[Tensor, "ray point 3"]
    steps: Float[Tensor, "ray 1"]


class Rays:
    """All rays of a scan that meet the grid.

    Parameters
    ----------
    images : line integrals per channel [no unit]
    weights : 0 for rays that were not measured; None where all were
    geometry : poses of the views
    grid : grid of the volume
    seed : seed of the choice

    Raises
    ------
    GeometryError
        When no ray meets the grid.
    """

    def __init__(self, images: Images, weights: Weights | None, geometry: Geometry, grid: Grid, seed: int) -> None:
        pair = ProjectorPair(geometry, grid)
        met = pair.lengths > 0 if weights is None else (pair.lengths > 0) & (weights > 0)
        bright = np.max(images, axis=0)
        self.images, self.shape, self.rng = images, met.shape, np.random.default_rng([seed, 4])
        self.met, self.met_numbers = met, np.flatnonzero(met)
        mask = np.flatnonzero(met & (bright > FOREGROUND * bright.max(initial=0.0)))
        self.mask = mask if len(mask) else self.met_numbers
        self.frames = pair.geometry.ray_frames()
        first = np.array(grid.origin[::-1]) - np.array(grid.spacing[::-1]) / 2
        size = np.array(grid.shape[::-1]) * grid.spacing[::-1]
        self.low, self.high = first, first + size

    def anywhere(self, count: int) -> RayNumbers:
        """Choose rays among all that meet the grid.

        Parameters
        ----------
        count : number of rays

        Returns
        -------
        numbers of the rays
        """
        return self.rng.choice(self.met_numbers, count)

    def masked(self, count: int) -> RayNumbers:
        """Choose half of the rays anywhere, and half in windows in front of the object.

        Parameters
        ----------
        count : number of rays, about

        Returns
        -------
        numbers of the rays, those of the windows first

        Notes
        -----
        This is the masked local-global sampling of SAX-NeRF, which chooses all rays in front of the object. Rays beside
        the object are added here, as they show where attenuation is zero.
        """
        _, rows, columns = self.shape
        windows = max(count // 2 // WINDOW**2, 1)
        view, row, column = np.unravel_index(self.rng.choice(self.mask, windows), self.shape)
        row, column = (
            np.clip(middle - WINDOW // 2, 0, max(size - WINDOW, 0)) for middle, size in ((row, rows), (column, columns))
        )
        down, across = (x.ravel() for x in np.mgrid[: min(WINDOW, rows), : min(WINDOW, columns)])
        local = np.ravel_multi_index((view[:, None], row[:, None] + down, column[:, None] + across), self.shape).ravel()
        local = local[self.met.ravel()[local]]
        return np.concatenate([local, self.anywhere(max(count - len(local), 1))])

    def measured(self, numbers: RayNumbers) -> Float[Tensor, "ray channel"]:
        """Return the measured values of rays.

        Parameters
        ----------
        numbers : numbers of the rays

        Returns
        -------
        line integrals per channel [no unit]
        """
        return torch.from_numpy(self.images.reshape(len(self.images), -1)[:, numbers].T.astype(np.float32))

    def points(self, numbers: RayNumbers, count: int) -> Points:
        """Choose one random point in each of `count` equal parts of a ray's path through the grid.

        Parameters
        ----------
        numbers : numbers of the rays
        count : points per ray

        Returns
        -------
        points and their lengths
        """
        view, row, column = np.unravel_index(numbers, self.shape)
        source, first, column_step, row_step = np.moveaxis(self.frames[view], 1, 0)
        along = first + column[:, None] * column_step + row[:, None] * row_step
        with np.errstate(divide="ignore", invalid="ignore"):
            planes = np.stack([(bound - source) / along for bound in (self.low, self.high)])
        enter = np.clip(np.nanmax(planes.min(axis=0), axis=1), 0, 1)
        leave = np.clip(np.nanmin(planes.max(axis=0), axis=1), 0, 1)
        part = np.maximum(leave - enter, 0) / count
        t = enter[:, None] + part[:, None] * (np.arange(count) + self.rng.uniform(size=(len(numbers), count)))
        places = source[:, None] + t[..., None] * along[:, None]
        inside = 2 * (places - self.low) / (self.high - self.low) - 1
        steps = part * np.linalg.norm(along, axis=1)
        return Points(torch.from_numpy(inside).float(), torch.from_numpy(steps).float()[:, None])
