"""Quality of the images of an insert: contrast, noise, spectra, and d' of observers."""

import json
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from phantomgen.geometry.voxel_grid import Grid
from phantomgen.runtime.plain_json import write_json
from recon.detectability.classes import QUALITY, Classes
from recon.detectability.insert import Insert
from recon.quality.edge_response import edge_response, edge_width, mtf
from recon.quality.noise_power import noise_power
from recon.quality.observers import Detectability, channelised_hotelling, without_prewhitening
from recon.readouts.quantity import Quantity, in_pieces
from spectra.errors import DatasetError, InputError

CORE = 0.7  # of the radius; the part of an insert that its edge does not reach
REACH = 0.75  # of the radius; distance from the edge on both sides
LEAST_RADIUS = 4  # voxels; a smaller insert has no plateau, and so no edge response
CLOSE = 2.0  # of the radius; images that are compared with the signal itself end there


@dataclass(frozen=True, eq=False)
class ImageQuality:
    """What images of an insert show.

    Parameters
    ----------
    insert : the insert
    about, unit : of the images
    pairs : number of reconstructions with and without it
    contrast : mean of the insert's core over its surroundings [unit]
    noise : standard deviation of a voxel without the insert [unit]
    without_prewhitening, hotelling : d' of both observers of images
    ideal : d' of the ideal observer of the counts of the training views, the ceiling of any reconstruction
    frequency, power : noise power spectrum of axial slices [1/mm] and [unit^2 mm^2]
    task_frequency, task_transfer : task transfer function, of the insert's edge [1/mm] and [no unit]; empty for an
        insert of less than `LEAST_RADIUS` voxels
    edge : distance over which the edge falls from 90 to 10 % [mm]; NaN where that is not known
    images : reconstruction with and without the insert, and mean difference of both classes (3, rows, columns) [unit]
    """

    insert: Insert
    about: str
    unit: str
    pairs: int
    contrast: float
    noise: float
    without_prewhitening: Detectability
    hotelling: Detectability
    ideal: float
    frequency: Float[np.ndarray, " frequency"]
    power: Float[np.ndarray, " frequency"]
    task_frequency: Float[np.ndarray, " task_frequency"]
    task_transfer: Float[np.ndarray, " task_frequency"]
    edge: float
    images: Float[np.ndarray, "3 row column"]

    @property
    def contrast_to_noise(self) -> float:
        """Contrast over the noise of a voxel."""
        return self.contrast / self.noise

    def numbers(self) -> dict[str, Any]:
        """Return all numbers but the images.

        Returns
        -------
        values by name, which JSON takes after `phantomgen.runtime.plain_json.plain`
        """
        found = asdict(self) | {"insert": str(self.insert), "contrast_to_noise": self.contrast_to_noise}
        del found["images"]
        return found

    def write(self, path: Path) -> None:
        """Write everything as JSON.

        Parameters
        ----------
        path : the file
        """
        write_json(path, self.numbers() | {"images": self.images})

    @classmethod
    def read(cls, path: Path) -> "ImageQuality":
        """Read what was written.

        Parameters
        ----------
        path : the file

        Returns
        -------
        equal numbers and images

        Raises
        ------
        DatasetError
            When the file cannot be read, or is another one.
        """
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
            values = {field.name: found[field.name] for field in fields(cls)}
            arrays = ("frequency", "power", "task_frequency", "task_transfer", "images")
            values |= {name: np.array(values[name], np.float64) for name in arrays}
            values |= {name: Detectability(**values[name]) for name in ("without_prewhitening", "hotelling")}
            values |= {"insert": Insert.parse(values["insert"]), "edge": values["edge"] or float("nan")}
            return cls(**values)
        except (OSError, ValueError, TypeError, KeyError, InputError) as error:
            raise DatasetError(f"{path} cannot be read as what recon quality writes ({error})") from None


def stored_qualities(run: Path) -> list[ImageQuality]:
    """Read what ``recon quality`` found for a run.

    Parameters
    ----------
    run : folder of the run

    Returns
    -------
    quality of each insert and quantity, in the order of their names
    """
    return [ImageQuality.read(path) for path in sorted((run / QUALITY).glob("*/*.json"))]


def measure(classes: Classes, shown: Quantity) -> ImageQuality:
    """Measure the images of a quantity.

    Parameters
    ----------
    classes : reconstructions with and without the insert
    shown : quantity of the images, such as CT numbers

    Returns
    -------
    contrast, noise, spectra and d' of the observers; images are means over the slices of the insert
    """
    insert, grid = classes.insert, classes.present.grid
    layers, (rows, columns, centre) = insert.layers(grid), insert.window(grid)
    box = (layers, rows, columns)
    present, absent = (
        np.stack([in_pieces(shown, values[:, *box]).astype(np.float64) for values in found.each()])
        for found in (classes.present, classes.absent)
    )
    part = grid.part(box)
    core, pairs = _disk(part, insert, CORE), len(present)
    deviations = (absent - absent.mean(axis=0)) * np.sqrt(pairs / (pairs - 1))
    difference = present.mean(axis=0) - absent.mean(axis=0)
    spectra = [noise_power(noise, part, np.s_[:, :, :]) for noise in deviations]
    close_rows, close_columns, close_centre = insert.window(grid, CLOSE)
    close = np.s_[
        :,
        close_rows.start - rows.start : close_rows.stop - rows.start,
        close_columns.start - columns.start : close_columns.stop - columns.start,
    ]
    flat_present, flat_absent = present.mean(axis=1), absent.mean(axis=1)
    frequency, transfer, width = _edge(difference, part, insert)
    return ImageQuality(
        insert=insert,
        about=shown.about,
        unit=shown.unit,
        pairs=pairs,
        contrast=float(difference[core].mean()),
        noise=float(np.sqrt((deviations[:, core] ** 2).mean())),
        without_prewhitening=without_prewhitening(flat_present[close], flat_absent[close], close_centre),
        hotelling=channelised_hotelling(flat_present, flat_absent, centre),
        ideal=classes.ideal,
        frequency=spectra[0][0],
        power=np.mean([power for _, power in spectra], axis=0),
        task_frequency=frequency,
        task_transfer=transfer,
        edge=width,
        images=np.stack([flat_present[0], flat_absent[0], difference.mean(axis=0)]),
    )


def _disk(part: Grid, insert: Insert, scale: float) -> Bool[np.ndarray, "z y x"]:
    """Mark the voxels of slices through an insert whose distance from its axis is small."""
    x, y = part.axis("x") - insert.center[0], part.axis("y") - insert.center[1]
    inside = np.hypot(x[None, :], y[:, None]) <= max(scale * insert.radius, 0.71 * part.spacing[1])
    return np.broadcast_to(inside, part.shape)


def _edge(
    difference: Float[np.ndarray, "z y x"], part: Grid, insert: Insert
) -> tuple[Float[np.ndarray, " frequency"], Float[np.ndarray, " frequency"], float]:
    """Compute task transfer function and width of the edge of an insert."""
    radius, voxel = insert.radius, part.spacing[1]
    if radius < LEAST_RADIUS * voxel:
        return np.empty(0), np.empty(0), float("nan")
    x, y, z = part.axis("x") - insert.center[0], part.axis("y") - insert.center[1], part.axis("z") - insert.center[2]
    across = x[None, None, :] ** 2 + y[None, :, None] ** 2
    apart = np.sqrt(across + (z[:, None, None] ** 2 if insert.length is None else 0.0)) - radius
    for step in (0.5 * voxel, 0.75 * voxel, voxel):
        try:
            distance, response = edge_response(difference, np.broadcast_to(apart, part.shape), REACH * radius, step)
        except InputError:  # a bin without a voxel, or no edge
            continue
        frequency, transfer = mtf(response, step)
        seen = frequency <= 0.5 / voxel
        return frequency[seen], transfer[seen], edge_width(distance, response)
    return np.empty(0), np.empty(0), float("nan")
