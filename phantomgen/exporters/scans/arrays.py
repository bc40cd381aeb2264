"""Arrays of projections on disk, written view by view, so that memory holds one view."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
from jaxtyping import Shaped

from phantomgen.exporters.projections import Projections

Stack = Shaped[np.ndarray, "view row column"]


def file_name(name: str) -> str:
    """Return the name of a channel or a basis function as part of a file's name.

    Parameters
    ----------
    name : of the channel or the basis function

    Returns
    -------
    the same without separators of folders and spaces
    """
    return "".join("_" if letter in '/\\:*?"<>| ' else letter for letter in name)


class Frames:
    """Part of a dataset in an HDF5 file, to be written as an array of views.

    Parameters
    ----------
    data : the dataset
    first : index of the first view along its axis
    before : indices before that axis, such as the channel
    """

    def __init__(self, data: h5py.Dataset, first: int = 0, before: tuple[int, ...] = ()) -> None:
        self.data, self.first, self.before = data, first, before

    def __setitem__(self, view: int, image: Shaped[np.ndarray, "row column"]) -> None:
        self.data[(*self.before, self.first + view)] = image


def fill(projections: Projections, stacks: Sequence[Stack | Frames]) -> None:
    """Write all views into arrays; each is computed once.

    Parameters
    ----------
    projections : what to write
    stacks : one array (view, row, column) per name
    """
    for view in range(len(projections)):
        for stack, image in zip(stacks, projections.image(view), strict=True):
            stack[view] = image


def at_equal_output(projections: Projections) -> Projections:
    """Divide counts by the tube output of their view, for formats that have no place for it.

    Parameters
    ----------
    projections : counts

    Returns
    -------
    the same as if the tube output were that of the flats in every view
    """
    darks, exposure = projections.darks, projections.exposure
    if exposure is None:
        return projections
    dark = 0.0 if darks is None or not len(darks) else darks.mean(axis=0)

    def image(view: int) -> Shaped[np.ndarray, "name row column"]:
        return (projections.image(view) - dark) / exposure[view][:, None, None] + dark

    return replace(projections, image=image)


def write_npy(
    folder: Path, projections: Projections, axes: tuple[int, int, int] = (0, 1, 2), rows_up: bool = False
) -> None:
    """Write one ``.npy`` of float32 per name.

    Parameters
    ----------
    folder : that gets the files
    projections : what to write
    axes : of (view, row, column), in the order of the program
    rows_up : whether the program's rows count upwards
    """
    panel = projections.geometry.panel
    shape = len(projections), panel.rows, panel.columns
    files = [
        np.lib.format.open_memmap(
            folder / f"{file_name(name)}.npy", "w+", np.float32, tuple(shape[axis] for axis in axes)
        )
        for name in projections.names
    ]
    stacks = [file.transpose(*np.argsort(axes)) for file in files]
    fill(projections, [stack[:, ::-1] if rows_up else stack for stack in stacks])
    for file in files:
        file.flush()
