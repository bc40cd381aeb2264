"""A scan as any format gives it: values view by view, open-beam frames, poses, and what is known of the beam."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, Shaped

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.importers.scans.stated import Stated

Values = Literal["counts", "readings", "line-integrals"]
Image = Shaped[np.ndarray, "channel row column"]
Frames = Shaped[np.ndarray, "_frame _channel _row _column"]  # sizes are those of a file, not yet compared with others


@dataclass(frozen=True, eq=False)
class RawScan:
    """What a format gives.

    Parameters
    ----------
    path : of the file or folder
    title : name of the scan
    values : ``counts`` of photons; ``readings``, numbers that are proportional to the signal above the dark level; or
        ``line-integrals``, -log of the part of the signal that passes
    channels : names of the channels
    geometry : poses of all views, those for training first
    image : returns all channels of a view
    stated : facts about beam and detector, with those of the file
    flats, darks : frames of the open beam and without beam, None where there are none
    exposure : tube output of each view and channel relative to the flats, None where it is the same
    train : number of views for training; None for all
    grid : voxels that the format asks for
    notes : sentences on what was taken to be so
    """

    path: Path
    title: str
    values: Values
    channels: tuple[str, ...]
    geometry: Geometry
    image: Callable[[int], Image]
    stated: Stated
    flats: Frames | None = None
    darks: Frames | None = None
    exposure: Float[np.ndarray, "view channel"] | None = None
    train: int | None = None
    grid: Grid | None = None
    notes: tuple[str, ...] = ()
