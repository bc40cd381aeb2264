"""Window of a run: slices of truth, result and difference, surfaces, and Gaussians."""

from dataclasses import dataclass
from functools import partial
from math import lcm
from typing import Any

import numpy as np
import pyvista

from phantomgen.display.viewer.content import Triple
from phantomgen.display.viewer.drawing import SIZE, SOLID, draw_planes, draw_surfaces, look_at_volume, usual_size
from phantomgen.display.viewer.panes import FONT, Pane
from recon.output.viewer.content import RunContent
from recon.output.viewer.controls import Controls
from recon.output.viewer.ellipsoid_markers import COARSE, FINE, MOST, MOST_IN_A_PAGE, ellipsoids
from recon.output.viewer.pointer import Pointer, PointerValues
from recon.output.viewer.surfaces import SurfacePanel, surfaces
from spectra.basis.basis import pretty

_NEARLY_ALL = 0.995  # part of the mass that is called all of it, as less rounds to 99 %
DIVERGING = "RdBu_r"
TRUTH, RESULT, DIFFERENCE = "truth", "result", "difference"

Place = tuple[int, int]
Key = tuple[str, int]  # kind of a panel, and position of its basis


@dataclass(frozen=True)
class Layout:
    """Positions of the panels.

    Parameters
    ----------
    shape : rows and columns of cells
    groups : cells that are one panel, as pyvista takes them
    slices : positions of the panels of slices, by kind and by row or column
    others : positions of the panels of surfaces and Gaussians
    """

    shape: Place
    groups: list[tuple[Any, Any]]
    slices: dict[Key, Place]
    others: list[Place]


def draw(
    content: RunContent,
    bases: list[int],
    levels: dict[str, float] | None = None,
    size: tuple[int, int] | None = None,
    off_screen: bool = True,
    for_page: bool = False,
    pointed: PointerValues | None = None,
) -> tuple[pyvista.Plotter, list[Pane]]:
    """Create a window with all panels, which turn together.

    Parameters
    ----------
    content : content to show
    bases : numbers of the bases whose slices are shown
    levels : levels of surfaces [1/mm]; see `recon.output.viewer.surfaces.surfaces`
    size : width and height [pixel]; None for a size that holds all panels
    off_screen : whether it is for a picture, and no window opens
    for_page : whether it is for a page: words are not drawn, as the caller finds them in the panels, and Gaussians are
        fewer and coarser
    pointed : values that a window tells under the pointer; None for none

    Returns
    -------
    window and panels
    """
    bodies = surfaces(content, levels)
    kinds = [RESULT] if content.true is None else [TRUTH, RESULT, DIFFERENCE]
    found = layout(kinds, len(bases), len(bodies) + (content.gaussians is not None))
    size = size or usual_size(found.shape[1])
    plotter = pyvista.Plotter(
        off_screen=off_screen,
        shape=found.shape,
        groups=found.groups or None,  # type: ignore[arg-type]
        window_size=list(size),
        border=False,
        title=f"recon view: {content.name}",
    )
    font = max(round(FONT * min(size[0] / SIZE[0], size[1] / SIZE[1]) * _smaller(found.shape)), 6)
    panes = {key: Pane(plotter, place, font, for_page) for key, place in found.slices.items()}
    others = [Pane(plotter, place, font, for_page) for place in found.others]
    for (kind, i), pane in panes.items():
        draw_slices(pane, kind, bases[i], content.at, content)
        look_at_volume(pane, content.grid)
    for pane, panel in zip(others, bodies, strict=False):
        draw_bodies(pane, content, panel)
    if content.gaussians is not None:
        draw_gaussians(others[-1], content)
    every = [*panes.values(), *others]
    plotter.link_views([pane.index for pane in every])
    for pane in every:
        pane.finish()
    for row, column in np.ndindex(found.shape):
        plotter.renderers[plotter.renderers.loc_to_index((row, column))].set_background("white")
    if not off_screen:
        controls = Controls(content, panes, partial(draw_slices, content=content), bases, content.at)
        controls.bind()
        if pointed is not None:
            pointer = Pointer(panes, pointed)
            pointer.bind()
            controls.drawn = pointer.again
    if not for_page:
        plotter.enable_anti_aliasing("ssaa", all_renderers=True)
    return plotter, every


def draw_slices(pane: Pane, kind: str, basis: int, at: Triple, content: RunContent) -> None:
    """Draw three slices through the truth, the result or the difference of one basis, with a colour bar.

    Parameters
    ----------
    pane : panel
    kind : ``truth``, ``result`` or ``difference``
    basis : number of the basis
    at : positions of the planes (x, y, z) [mm]
    content : content to show
    """
    pane.plotter.subplot(*pane.place)
    (top, ticks), name = content.scale(basis), pretty(content.basis_names[basis])
    if kind == DIFFERENCE:
        end, values = content.difference_scale(basis), content.difference(basis)
        pane.set_bar(end, 3, -end, DIVERGING)
    else:
        values = content.true[basis] if kind == TRUTH and content.true is not None else content.result[basis]
        pane.set_bar(top, ticks)
    draw_planes(pane, values, content.filled, content.grid, at)
    pane.words.title = f"{name}, {kind}" if kind != DIFFERENCE else f"{name}, result - truth"
    if kind == DIFFERENCE:
        pane.words.note = content.errors(basis)


def draw_bodies(pane: Pane, content: RunContent, panel: SurfacePanel) -> None:
    """Draw translucent surfaces of materials, or of levels.

    Parameters
    ----------
    pane : panel
    content : content to show
    panel : title, bodies and colours
    """
    draw_surfaces(pane, panel.bodies, panel.colours, content.grid)
    pane.words.title = panel.title


def draw_gaussians(pane: Pane, content: RunContent) -> None:
    """Draw ellipsoids of the Gaussians beyond the plane y, in colours mixed from their bases.

    Parameters
    ----------
    pane : panel
    content : content to show
    """
    from recon.figures.basis_colours import basis_colours  # noqa: PLC0415

    if content.gaussians is None:
        return
    pane.plotter.subplot(*pane.place)
    most = (MOST_IN_A_PAGE, COARSE) if pane.for_page else (MOST, FINE)
    plain = content.gaussians.plain()
    found = ellipsoids(plain, content.at[1], *most)
    if found.count:
        pane.plotter.add_mesh(found.mesh, scalars="colour", rgb=True, smooth_shading=True, **SOLID)
    names = content.gaussians.basis_names
    pane.words.legend = [(pretty(n), c) for n, c in zip(names, basis_colours(names), strict=True)]
    whole = len(content.gaussians)
    parts = f"{whole}" if len(plain) == whole else f"{len(plain)} sides of {whole}"
    pane.words.title = f"{found.count} of {parts} Gaussians"
    share = "" if found.share > _NEARLY_ALL else f"{100 * found.share:.0f} % of mass at "
    pane.words.note = f"{share}y > {content.at[1]:.4g} mm, 1 sigma"
    look_at_volume(pane, content.grid)


def layout(kinds: list[str], bases: int, others: int) -> Layout:
    """Arrange the panels.

    Parameters
    ----------
    kinds : kinds of slices
    bases : number of bases whose slices are shown
    others : number of panels of surfaces and Gaussians

    Returns
    -------
    positions: slices of one basis in a row above the others; those of several bases in columns, the others in one more
    """
    if len(kinds) > 1 and bases > 1:
        shape = (max(len(kinds), others), bases + 1)
        slices = {(kind, i): (k, i) for k, kind in enumerate(kinds) for i in range(bases)}
        return Layout(shape, [], slices, [(row, bases) for row in range(others)])
    keys = [(kind, i) for i in range(bases) for kind in kinds]
    columns = lcm(len(keys), others)
    if len(keys) == 1 and others <= 2:
        return Layout((1, 1 + others), [], {keys[0]: (0, 0)}, [(0, 1 + i) for i in range(others)])
    top, below = (
        [range(i * w, i * w + w) for i in range(columns // w)] for w in (columns // len(keys), columns // others)
    )
    groups: list[tuple[Any, Any]] = [(0, list(cells)) for cells in top if len(cells) > 1]
    groups += [(1, list(cells)) for cells in below if len(cells) > 1]
    slices = {key: (0, cells[0]) for key, cells in zip(keys, top, strict=True)}
    return Layout((2, columns), groups, slices, [(1, cells[0]) for cells in below])


def _smaller(shape: Place) -> float:
    """Factor of the size of letters, for many panels."""
    return 0.82 if shape[0] > 2 else 1.0
