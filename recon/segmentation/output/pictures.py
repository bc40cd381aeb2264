"""Pictures of material maps: slices beside the truth, and views from any direction."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from skimage.io import imsave

from phantomgen.display.figures.style import WIDTH, figure_file
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.figures.run_figures import borders
from recon.segmentation.labelling import NOTHING
from recon.segmentation.output.table import legend
from recon.segmentation.rendering import picture, views_around, voxel_lengths
from recon.segmentation.result import Segmentation
from recon.segmentation.scoring.reference import Reference
from recon.segmentation.scoring.scores import confusion, lengths_of, match, matched_colours

DEFAULT_VIEWS = ((0.0, 0.0), (90.0, 0.0), (30.0, 35.0))  # degrees; azimuth and elevation
_PLANES = (("axial", 0, "x", "y"), ("coronal", 1, "x", "z"))
_LEGEND_COLUMNS = 3  # columns of the legend


def write_views(folder: Path, segmentation: Segmentation, views: Sequence[tuple[float, float]]) -> list[Path]:
    """Write ``view_<azimuth>_<elevation>.png`` of every view.

    Parameters
    ----------
    folder : folder to write to
    segmentation : material maps
    views : azimuth and elevation of each view [degree]

    Returns
    -------
    paths of the pictures
    """
    paths = []
    for azimuth, elevation in views:
        image = picture(lengths_of(segmentation, _view(segmentation, azimuth, elevation))[0], segmentation.colours)
        path = folder / f"view_{azimuth:g}_{elevation:g}.png"
        imsave(path, np.rint(255 * image).astype(np.uint8), check_contrast=False)
        paths.append(path)
    return paths


def draw_materials(path: Path, segmentation: Segmentation, reference: Reference | None) -> None:
    """Draw middle slices and a view of the material maps, beside those of the truth where there is one.

    Parameters
    ----------
    path : file to write
    segmentation : material maps
    reference : truth, whose materials give their colours to the clusters that match them; None where there is none
    """
    s, grid = segmentation, segmentation.subject.grid
    colours = s.colours
    if reference is not None:
        counts = confusion(reference.truth.labels, s.labels, len(reference.materials), len(s.clusters))
        colours = matched_colours(s, reference, match(counts))
    view = _view(s, *DEFAULT_VIEWS[-1])
    rows = [_Row("result", s.rgb(colours), picture(lengths_of(s, view)[0], colours))]
    if reference is not None:
        volumes = reference.volumes
        seen = picture(voxel_lengths(volumes, grid, view)[0], reference.colours)
        rows.insert(0, _Row("truth", reference.rgb(), seen))
    _draw(path, grid, rows, list(zip(legend(s.clusters), colours, strict=True)))


def _view(segmentation: Segmentation, azimuth: float, elevation: float) -> Geometry:
    """Pose of one view [degree] of all that is not air."""
    return views_around(segmentation.subject.grid, [(azimuth, elevation)], segmentation.labels > NOTHING)


class _Row(NamedTuple):
    """Row of a figure: name, RGB of all voxels, and RGB of a view, 0 to 1."""

    name: str
    volume: Float[np.ndarray, "z y x 3"]
    view: Float[np.ndarray, "row column 3"]


def _draw(
    path: Path,
    grid: Grid,
    rows: list[_Row],
    entries: list[tuple[str, np.ndarray]],
) -> None:
    """Draw a row per volume, with a column per slice and one for the view, and the legend below."""
    from matplotlib.patches import Patch  # noqa: PLC0415 - half a second

    depth, deep, wide = np.array(grid.shape) * grid.spacing  # along z, y and x [mm]
    ratios = [1.0, 1.0, rows[0].view.shape[1] / rows[0].view.shape[0] * max(deep, depth) / wide]
    lines = -(-len(entries) // _LEGEND_COLUMNS)
    side = (WIDTH - 0.6) / sum(ratios)
    high = side * max(deep, depth) / wide
    with figure_file(path, (WIDTH, (high + 0.25) * len(rows) + 0.5 + 0.19 * lines)) as figure:
        axes = figure.subplots(len(rows), 3, squeeze=False, width_ratios=ratios)
        for line, (name, volume, seen) in zip(axes, rows, strict=True):
            for ax, (plane, axis, across, up) in zip(line, _PLANES, strict=False):
                middle = grid.shape[axis] // 2
                extent = [*borders(grid, across), *borders(grid, up)]
                ax.imshow(volume.take(middle, axis=axis), extent=extent, origin="lower")
                place = f"{'zyx'[axis]} = {grid.axis('zyx'[axis])[middle]:.3g} mm"
                ax.set_title(f"{name}, {plane}, {place}")
                ax.set_ylabel(f"{up} [mm]")
                ax.set_xlabel(f"{across} [mm]" if line is axes[-1] else "")
            line[2].imshow(seen)
            line[2].set_title("{}, seen from {:g}°, {:g}°".format(name, *DEFAULT_VIEWS[-1]))
            line[2].set_xticks([])
            line[2].set_yticks([])
        for ax in axes.flat:
            ax.spines[:].set_visible(True)
        patches = [
            Patch(facecolor=tuple(colour), edgecolor="0.3", linewidth=0.5, label=text) for text, colour in entries
        ]
        title = "materials found; $\\rho$ in 10$^{-3}$ mm$^{-1}$"
        figure.legend(handles=patches, loc="outside lower center", ncols=_LEGEND_COLUMNS, title=title, frameon=False)
