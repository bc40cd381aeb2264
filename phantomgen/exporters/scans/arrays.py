"""Arrays of projections on disk, written view by view, so that memory holds one view."""

from pathlib import Path

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


def fill(projections: Projections, stacks: list[Stack]) -> None:
    """Write all views into arrays.

    Parameters
    ----------
    projections : what to write
    stacks : one array (view, row, column) per name
    """
    for view in range(len(projections)):
        for stack, image in zip(stacks, projections.image(view), strict=True):
            stack[view] = image


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
    back = np.argsort(axes)
    stacks = []
    for name in projections.names:
        path = folder / f"{file_name(name)}.npy"
        file = np.lib.format.open_memmap(path, "w+", np.float32, tuple(shape[axis] for axis in axes))
        stack = file.transpose(*back)
        stacks.append(stack[:, ::-1] if rows_up else stack)
    fill(projections, stacks)
    for stack in stacks:
        stack.base.flush() if isinstance(stack.base, np.memmap) else None
