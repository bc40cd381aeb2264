"""Figure and film of the phases of a scan."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from phantomgen.display.figures.style import UNIT, WIDTH, figure_file
from phantomgen.geometry.voxel_grid import Grid
from recon.figures.run_figures import borders
from spectra.basis.basis import pretty

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Phases that the figure shows side by side, at most; frames of the film each second.
_MOST_COLUMNS, _FRAMES_PER_SECOND = 8, 4

Phases = Float[np.ndarray, "phase basis z y x"]


def most_changing(volumes: Phases) -> tuple[int, int, int]:
    """Find where phases differ most: a basis, an axis and a slice across it.

    Parameters
    ----------
    volumes : of all phases [1/mm]

    Returns
    -------
    index of the basis, 0 (z) or 1 (y) for the axis, and index of the slice; differences are relative to the largest
    value of the basis
    """
    peaks = np.maximum(volumes.max(axis=(0, 2, 3, 4)), 1e-30)
    spread = volumes.std(axis=0) / peaks[:, None, None, None]
    basis = int(np.square(spread).sum(axis=(1, 2, 3)).argmax())
    sums = [np.square(spread[basis]).sum(axis=tuple({0, 1, 2} - {axis})) for axis in (0, 1)]
    axis = int(np.argmax([values.max() for values in sums]))
    return basis, axis, int(sums[axis].argmax())


def draw_phases(volumes: Phases, true: Phases | None, names: Sequence[str], grid: Grid, path: Path) -> "Figure":
    """Draw a slice of every phase where they differ most: truth, result and difference from the first phase.

    Parameters
    ----------
    volumes : of all phases [1/mm]
    true : truth of all phases [1/mm]; None where it is not known
    names : of the bases
    grid : of the volumes
    path : figure to write

    Returns
    -------
    the figure
    """
    basis, axis, at = most_changing(volumes if true is None else true)
    shown = np.unique(np.linspace(0, len(volumes) - 1, min(len(volumes), _MOST_COLUMNS)).round().astype(int))
    result = 1e3 * volumes[:, basis].take(at, axis=axis + 1)
    rows = {} if true is None else {"truth": 1e3 * true[:, basis].take(at, axis=axis + 1)}
    rows["result"] = result
    across, up = ("x", "y") if axis == 0 else ("x", "z")
    extent = (*borders(grid, across), *borders(grid, up))
    top = max(float(images.max()) for images in rows.values())
    changes = {f"{name}\n− phase 0": images - images[0] for name, images in rows.items()}
    largest = max(float(np.abs(images).max()) for images in changes.values()) or 1.0
    height = 1.1 * WIDTH / len(shown) * (extent[3] - extent[2]) / (extent[1] - extent[0])
    with figure_file(path, (WIDTH, height * 2 * len(rows) + 0.8)) as figure:
        axes = figure.subplots(2 * len(rows), len(shown), squeeze=False, sharex=True, sharey=True)
        for row, (name, images) in enumerate([*rows.items(), *changes.items()]):
            gray = row < len(rows)
            limits = (
                {"cmap": "gray", "vmin": 0, "vmax": top}
                if gray
                else {"cmap": "RdBu_r", "vmin": -largest, "vmax": largest}
            )
            for column, phase in enumerate(shown):
                one = axes[row, column]
                drawn = one.imshow(images[phase], origin="lower", extent=extent, **limits)
                one.set_xticks([])
                one.set_yticks([])
                if row == 0:
                    one.set_title(f"phase {phase}", fontsize="small")
            axes[row, 0].set_ylabel(name)
            figure.colorbar(drawn, ax=axes[row].tolist(), label=UNIT, fraction=0.02, pad=0.01)
        place = f"{'zy'[axis]} = {grid.axis('zy'[axis])[at]:.3g} mm"
        figure.suptitle(
            f"{pretty(names[basis])}, {'axial' if axis == 0 else 'coronal'} slice, {place}", fontsize="medium"
        )
    return figure


def draw_film(volumes: Phases, true: Phases | None, names: Sequence[str], grid: Grid, path: Path) -> None:
    """Write a film of the slice where phases differ most, every basis beside its truth.

    Parameters
    ----------
    volumes : of all phases [1/mm]
    true : truth of all phases [1/mm]; None where it is not known
    names : of the bases
    grid : of the volumes
    path : GIF to write
    """
    from matplotlib.animation import FuncAnimation, PillowWriter  # noqa: PLC0415 - slow, and only here
    from matplotlib.figure import Figure  # noqa: PLC0415

    _, axis, at = most_changing(volumes if true is None else true)
    parts = [("result", volumes)] if true is None else [("truth", true), ("result", volumes)]
    across, up = ("x", "y") if axis == 0 else ("x", "z")
    extent = (*borders(grid, across), *borders(grid, up))
    figure = Figure((2.4 * len(names), 2.4 * len(parts) + 0.5), layout="constrained")
    axes = figure.subplots(len(parts), len(names), squeeze=False)
    images = []
    for row, (name, values) in enumerate(parts):
        for basis, basis_name in enumerate(names):
            slices = values[:, basis].take(at, axis=axis + 1)
            top = parts[0][1][:, basis].take(at, axis=axis + 1).max()
            one = axes[row, basis]
            images.append((one.imshow(slices[0], origin="lower", extent=extent, cmap="gray", vmin=0, vmax=top), slices))
            one.set_xticks([])
            one.set_yticks([])
            one.set_title(pretty(basis_name) if row == 0 else "", fontsize="small")
            if basis == 0:
                one.set_ylabel(name)

    def show(phase: int) -> None:
        figure.suptitle(f"phase {phase}", fontsize="medium")
        for image, slices in images:
            image.set_data(slices[phase])

    film = FuncAnimation(figure, show, frames=len(volumes))  # type: ignore[arg-type]
    film.save(path, PillowWriter(fps=_FRAMES_PER_SECOND))
