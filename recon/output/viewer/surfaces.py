"""Surfaces in volumes of a result: of the materials that are known, or where a basis crosses a level."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Integer
from scipy.ndimage import gaussian_filter

from phantomgen.dataset.truth import Truth
from phantomgen.display.viewer.content import Material, box_of, lies_within, materials, part_of
from phantomgen.geometry.voxel_grid import Grid
from recon.figures.basis_colours import basis_colours
from recon.output.viewer.content import RunContent
from spectra.basis.basis import pretty
from spectra.errors import InputError

_SMOOTHING = 1.0  # voxels; a layer of one voxel at an edge that looks like a third material stays below one half


class SurfacePanel(NamedTuple):
    """Panel of surfaces.

    Parameters
    ----------
    title : title of the panel
    bodies : bodies whose surfaces are drawn
    colours : colour of each body
    """

    title: str
    bodies: list[Material]
    colours: list[str]


def surfaces(content: RunContent, levels: dict[str, float] | None) -> list[SurfacePanel]:
    """Create the panels of surfaces, first those of the truth where there is one.

    Parameters
    ----------
    content : content to show
    levels : levels of some bases [1/mm]; None for materials, or `usual_levels` where there is no truth

    Returns
    -------
    panels
    """
    from phantomgen.display.viewer.drawing import colour_of  # noqa: PLC0415 - pyvista

    if content.truth is not None and levels is None:
        true = materials(content.truth)
        found = [m for m in result_materials(content, content.truth) if m.fraction.max() > m.level]
        panels = (("true materials", true), ("materials in the result", found))
        return [SurfacePanel(title, shown, [colour_of(m) for m in shown]) for title, shown in panels]
    chosen = checked_levels(content, levels) if levels is not None else usual_levels(content)
    colours = basis_colours(content.basis_names)
    volumes = [("true levels", content.true)] if content.true is not None else []
    panels = []
    for title, values in [*volumes, ("levels in the result", content.result)]:
        shown = list(level_bodies(values, content.grid, content.basis_names, chosen))
        panels.append(SurfacePanel(title, shown, [colours[m.index] for m in shown]))
    return panels


def result_materials(content: RunContent, truth: Truth) -> list[Material]:
    """Find where the result is nearest to each material of the truth.

    Parameters
    ----------
    content : content to show
    truth : truth of the scan

    Returns
    -------
    materials of the truth, each with the voxels of the result whose coefficients are nearest to it. The parts are
    smoothed by one voxel: the layer of one voxel at an edge, which may look like a third material, and single voxels of
    noise have no surface then
    """
    labels = nearest_materials(content.result[: len(truth.basis_names)], truth.coefficients)
    shown = materials(truth)
    place = part_of(content.grid, tuple((-1, n + 1) for n in content.grid.shape))  # type: ignore[arg-type]
    parts = {m.index: _smoothed(labels, m.index + 1) for m in shown}
    return [Material(m.name, m.index, place, parts[m.index], _sum_within(m, shown, parts), 0.5) for m in shown]


def nearest_materials(
    volumes: Float[np.ndarray, "basis z y x"], coefficients: Float[np.ndarray, "material basis"]
) -> Integer[np.ndarray, "z y x"]:
    """Label voxels by the material whose coefficients are nearest, each basis relative to its largest coefficient.

    Parameters
    ----------
    volumes : coefficients [1/mm]
    coefficients : coefficients of the materials [1/mm]

    Returns
    -------
    0 where a voxel is nearest to zero, i + 1 where it is nearest to material i
    """
    largest = coefficients.max(axis=0)
    scale = np.where(largest > 0, largest, 1.0)
    centres = np.concatenate([np.zeros((1, len(scale))), coefficients / scale])
    labels = np.zeros(volumes.shape[1:], np.int32)
    for z in range(len(labels)):  # slice by slice, so that distances stay small in memory
        away = volumes[:, z, None] / scale[:, None, None, None] - centres.T[:, :, None, None]
        labels[z] = np.square(away).sum(axis=0).argmin(axis=0)
    return labels


def usual_levels(content: RunContent) -> dict[str, float]:
    """Compute the level of each basis that divides its voxels best into two classes.

    Parameters
    ----------
    content : content to show

    Returns
    -------
    levels by basis [1/mm]; a basis without positive values has none

    References
    ----------
    .. [1] Otsu 1979, A threshold selection method from gray-level histograms, doi:10.1109/TSMC.1979.4310076
    """
    from skimage.filters import threshold_otsu  # noqa: PLC0415 - a second

    levels = zip(content.basis_names, map(threshold_otsu, content.result), strict=True)
    return {name: float(level) for name, level in levels if level > 0}


def parse_levels(texts: tuple[str, ...]) -> dict[str, float] | None:
    """Read texts such as ``"compton=0.01"``.

    Parameters
    ----------
    texts : a basis and a level [1/mm] each

    Returns
    -------
    levels by basis; None where there are no texts

    Raises
    ------
    InputError
        When a text is no name with a positive number.
    """
    found = {}
    for text in texts:
        name, _, number = text.partition("=")
        try:
            found[name] = float(number)
        except ValueError:
            found[name] = 0.0
        if not (np.isfinite(found[name]) and found[name] > 0):
            raise InputError(f"a level is written BASIS=VALUE with a positive value in 1/mm, got {text!r}")
    return found or None


def checked_levels(content: RunContent, levels: dict[str, float]) -> dict[str, float]:
    """Refuse levels of bases that do not exist.

    Parameters
    ----------
    content : content to show
    levels : levels by basis [1/mm]

    Returns
    -------
    the levels

    Raises
    ------
    InputError
        When there is no such basis.
    """
    for name in levels:
        if name not in content.basis_names:
            raise InputError(f"{content.name} has no basis {name!r}, only {', '.join(content.basis_names)}")
    return levels


def level_bodies(
    volumes: Float[np.ndarray, "basis z y x"], grid: Grid, names: tuple[str, ...], levels: dict[str, float]
) -> Iterator[Material]:
    """Create the body above each level; a body that holds another is marked to be translucent.

    Parameters
    ----------
    volumes : coefficients [1/mm]
    grid : grid of the volumes
    names : names of the bases
    levels : levels by basis [1/mm]

    Yields
    ------
    bodies
    """
    above = {i: volumes[i] > levels[name] for i, name in enumerate(names) if name in levels}
    boxes = {i: box_of(filled) for i, filled in above.items() if filled.any()}
    for i, box in boxes.items():
        wide = tuple((max(a - 1, 0), min(b + 1, n)) for (a, b), n in zip(box, grid.shape, strict=True))
        values = np.pad(volumes[i][tuple(slice(a, b) for a, b in wide)], 1)
        holds = any(lies_within(other, box) and other != box for other in boxes.values())
        place = part_of(grid, tuple((a - 1, b + 1) for a, b in wide))  # type: ignore[arg-type]
        name = f"{pretty(names[i])} above {levels[names[i]]:.2g} 1/mm"
        yield Material(name, i, place, values, np.zeros_like(values) if holds else None, levels[names[i]])


def _smoothed(labels: Integer[np.ndarray, "z y x"], label: int) -> Float[np.ndarray, "padded_z padded_y padded_x"]:
    """Smoothed indicator of a label, with one empty voxel around the grid."""
    return np.pad(gaussian_filter((labels == label).astype(np.float32), _SMOOTHING, mode="constant"), 1)


def _sum_within(
    material: Material, shown: list[Material], parts: dict[int, Float[np.ndarray, "z y x"]]
) -> Float[np.ndarray, "z y x"] | None:
    """Sum of the materials that lie within one according to the truth; None where there are none."""
    if material.inner is None:
        return None
    low, high = _ends(material)
    held = []
    for other in shown:
        first, last = _ends(other)
        if other.index != material.index and (low <= first).all() and (last <= high).all():
            held.append(parts[other.index])
    return np.sum(held, axis=0) if held else None


def _ends(material: Material) -> tuple[np.ndarray, np.ndarray]:
    """First and last corner (z, y, x) of the grid of a material [mm]."""
    first = np.array(material.grid.origin)
    return first, first + np.multiply(material.grid.shape, material.grid.spacing)
