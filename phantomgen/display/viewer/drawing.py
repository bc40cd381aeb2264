"""Window of the viewer: slices per basis, surfaces per material, and the scan from outside."""

from typing import Any, cast

import numpy as np
import pyvista
from jaxtyping import Float, Shaped
from matplotlib.colors import to_hex, to_rgb

from phantomgen.dataset.truth import Truth
from phantomgen.display.figures.geometry import drawn_sources
from phantomgen.display.viewer.content import (
    Content,
    Limits,
    Material,
    Plane,
    Triple,
    limits,
    materials,
    object_limits,
    planes,
    round_scale,
    scan_title,
    source_path,
    usual_top,
)
from phantomgen.display.viewer.panes import FAINT, FONT, INK, Bar, Pane
from phantomgen.geometry.curved_panel import panel_edges
from phantomgen.geometry.voxel_grid import Grid
from spectra.basis.basis import pretty

MATERIAL_COLOURS = ("#56B4E9", "#E69F00", "#D55E00", "#CC79A7", "#009E73", "#0072B2", "#F0E442", "#999999")
_MIXED_WITH = ((0.0, 0.0), (1.0, 0.55), (0.0, 0.45))  # white or black, and how much of it
_PAGE_VOXELS, _PAGE_TRIANGLES = 192, 400_000  # most along an edge, most of all surfaces: some 20 MB
SOURCE, PANEL, CORNER, RAY = "#D55E00", "#0072B2", "#C2185B", "#E69F00"
VIEW = 0  # the view whose panel is drawn
SIZE = (1600, 1000)  # pixels
COLUMN = 400  # pixels that a column of panels has at least, where no size is given
_OBJECT_SEEN_FROM, _SCAN_SEEN_FROM = (0.6, -1.5, 0.95), (1.1, -1.4, 1.0)
_OBJECT_MARGINS, _SCAN_MARGINS = (0.05, 0.2, 0.05, 0.1), (0.18, 0.04, 0.18, 0.12)
SOLID: Any = {"ambient": 0.25, "diffuse": 0.85, "specular": 0.2, "specular_power": 20.0}


def draw(
    content: Content, size: tuple[int, int] | None = None, off_screen: bool = True, for_page: bool = False
) -> tuple[pyvista.Plotter, list[Pane]]:
    """Draw all content into a window.

    Parameters
    ----------
    content : what is shown
    size : width and height [pixel]; None for one that holds all panels
    off_screen : for a picture, not for a window that opens
    for_page : leave out the words, which the caller finds in the panels, and what would make a page heavy

    Returns
    -------
    the window and its panels
    """
    bases = len(content.truth.basis_names) if content.truth else 0
    shape, groups, places = _layout(bases)
    size = size or usual_size(bases)
    plotter = pyvista.Plotter(
        off_screen=off_screen,
        shape=shape,
        groups=groups,
        window_size=list(size),
        border=False,
        title=f"phantomgen view: {content.name}",
    )
    font = max(round(FONT * min(size[0] / SIZE[0], size[1] / SIZE[1])), 6)
    panes = [Pane(plotter, place, font, for_page) for place in places]
    if content.truth:
        for i, pane in enumerate(panes[:bases]):
            draw_basis(pane, content, content.truth, i)
        draw_materials(panes[-2], content, content.truth)
        plotter.link_views([pane.index for pane in panes[:-1]])
    draw_scan(panes[-1], content)
    for pane in panes:
        pane.finish()
    if not for_page:
        plotter.enable_anti_aliasing("ssaa", all_renderers=True)
    return plotter, panes


def usual_size(columns: int) -> tuple[int, int]:
    """Return the usual size of a window.

    Parameters
    ----------
    columns : number of columns of panels

    Returns
    -------
    width and height [pixel]
    """
    return max(SIZE[0], COLUMN * columns), SIZE[1]


def draw_basis(pane: Pane, content: Content, truth: Truth, basis: int) -> None:
    """Draw three slices through one basis volume that is not empty, with its colour bar.

    Parameters
    ----------
    pane : the panel
    content : content of the viewer
    truth : the truth
    basis : index of the basis
    """
    values = truth.volumes[basis]
    highest, usual = float(values.max()), usual_top(values)
    top, ticks = round_scale(usual)
    pane.set_bar(top, ticks)
    draw_planes(pane, values, np.logical_or.reduce(truth.fractions), content.grid, content.at)
    pane.words.title = pretty(truth.basis_names[basis])
    if highest > top:
        pane.words.note += f"; brightest colour up to {highest:.2g} 1/mm"
    look_at_volume(pane, content.grid)


def draw_planes(
    pane: Pane,
    values: Float[np.ndarray, "z y x"],
    filled: Shaped[np.ndarray, "z y x"],
    grid: Grid,
    at: Triple,
) -> None:
    """Draw three slices in the colours of the panel's bar, of voxels that are not zero in `filled`.

    Parameters
    ----------
    pane : the panel
    values : values, (z, y, x)
    filled : not zero in the voxels that are drawn, (z, y, x)
    grid : the voxels
    at : point in the slices (x, y, z) [mm]
    """
    pane.plotter.subplot(*pane.place)
    bar, most = cast("Bar", pane.words.bar), _PAGE_VOXELS if pane.for_page else max(grid.shape)
    colours: Any = {"clim": (bar.low, bar.top), "cmap": bar.colour_map, "lighting": False, "show_scalar_bar": False}
    shown = list(planes(values, grid, at))
    for plane, part in zip(shown, planes(filled, grid, at), strict=True):
        pane.stroke(_frame(plane), FAINT, 1)
        if part.values.any():
            mesh = plane_mesh(plane.thinned(most)).extract_cells(np.flatnonzero(part.thinned(most).values))
            pane.plotter.add_mesh(mesh, **colours)
    pane.words.note = ", ".join(f"{plane.axis} = {plane.position:.4g}" for plane in shown) + " mm"


def draw_materials(pane: Pane, content: Content, truth: Truth) -> None:
    """Draw translucent surfaces, one colour per material.

    Parameters
    ----------
    pane : the panel
    content : content of the viewer
    truth : the truth
    """
    shown = materials(truth)
    draw_surfaces(pane, shown, [colour_of(m) for m in shown], content.grid)
    pane.words.title = "materials"


def draw_surfaces(pane: Pane, shown: list[Material], colours: list[str], grid: Grid) -> None:
    """Draw surfaces with their names, translucent where something lies inside.

    Parameters
    ----------
    pane : the panel
    shown : materials
    colours : one for each material
    grid : the voxels
    """
    pane.plotter.subplot(*pane.place)
    most = _PAGE_TRIANGLES // max(len(shown), 10) if pane.for_page else None
    for material, colour in zip(shown, colours, strict=True):
        mesh, opacity = surface(material, most), 1.0 if material.inner is None else 0.22
        if mesh.n_cells:
            pane.plotter.add_mesh(mesh, color=colour, opacity=opacity, smooth_shading=True, **SOLID)
    pane.stroke(_box(limits(grid)), FAINT, 1)
    pane.words.legend = [(m.name.replace("_", " "), colour) for m, colour in zip(shown, colours, strict=True)]
    look_at_volume(pane, grid)


def draw_scan(pane: Pane, content: Content) -> None:
    """Draw the orbit of the source, and source, panel and central ray of one view around the object.

    Parameters
    ----------
    pane : the panel
    content : content of the viewer
    """
    pane.plotter.subplot(*pane.place)
    plotter, geometry, truth = pane.plotter, content.geometry, content.truth
    sources, (first, last) = drawn_sources(geometry, content.grid), panel_edges(geometry, VIEW)
    source, path = sources[VIEW], source_path(geometry, content.grid)
    corners, outline = (
        np.stack([first[0], first[-1], last[-1], last[0]]),
        np.concatenate([first, last[::-1], first[:1]]),
    )
    points = np.concatenate([path, sources, outline])
    size = float(np.ptp(points, axis=0).max())
    if len(path) > 1:
        pane.stroke(pyvista.MultipleLines(path), SOURCE, 2)
    pane.dots(sources, SOURCE, 5)
    plotter.add_mesh(pyvista.Sphere(radius=size / 60, center=source), color=SOURCE, **SOLID)
    surface = pyvista.StructuredGrid(*np.stack([first, last])[None].transpose(3, 0, 1, 2))
    plotter.add_mesh(surface, color=PANEL, opacity=0.3, lighting=False)
    pane.stroke(pyvista.MultipleLines(outline), PANEL, 2)
    plotter.add_mesh(pyvista.Sphere(radius=size / 90, center=corners[0]), color=CORNER, **SOLID)
    for corner in corners:
        start = source + corner - geometry.panel_center[VIEW] if geometry.is_parallel else source
        pane.stroke(pyvista.Line(start, corner), FAINT, 1)
    pane.stroke(pyvista.Line(source, geometry.panel_center[VIEW]), RAY, 2.5)
    pane.stroke(_box(limits(content.grid)), FAINT, 1)
    keys = [("volume", FAINT), ("central ray", RAY), (f"panel in view {VIEW}", PANEL), ("its pixel (0, 0)", CORNER)]
    where = "where the beam comes from" if geometry.is_parallel else "source"
    keys.append((f"{where}, larger in view {VIEW}", SOURCE))
    if truth is not None and (found := object_limits(truth)) is not None:
        pane.stroke(_box(found), INK, 1.5)
        keys.append(("bounds of the object", INK))
    pane.words.title = scan_title(geometry)
    pane.words.legend = keys
    _mark_axes(pane, content.grid, 0.8)
    pane.look(points, _SCAN_SEEN_FROM, _SCAN_MARGINS)


def look_at_volume(pane: Pane, grid: Grid) -> None:
    """Set a camera that shows the whole volume, and draw axes at a corner unless a legend stands there.

    Parameters
    ----------
    pane : the panel
    grid : the voxels
    """
    if not pane.words.legend:
        _mark_axes(pane, grid, 0.2)
    pane.look(_corners(limits(grid)), _OBJECT_SEEN_FROM, _OBJECT_MARGINS)


def _mark_axes(pane: Pane, grid: Grid, part: float) -> None:
    """Axes at the lowest corner of the volume, as long as a part of it."""
    low, high = np.array(limits(grid))
    pane.mark_axes(low, part * float((high - low).max()))


def plane_mesh(plane: Plane) -> pyvista.ImageData:
    """Create the mesh of a layer of voxels as cells, with exact edges.

    Parameters
    ----------
    plane : the layer

    Returns
    -------
    the mesh
    """
    i = "xyz".index(plane.axis)
    cells = list(plane.values.shape[::-1])
    cells.insert(i, 0)
    extent = np.subtract(plane.high, plane.low)
    extent[i] = 1.0
    mesh = pyvista.ImageData(dimensions=[n + 1 for n in cells], spacing=extent / np.maximum(cells, 1), origin=plane.low)
    mesh.cell_data["coefficient"] = plane.values.ravel()
    return mesh


def surface(material: Material, most: int | None = None) -> pyvista.PolyData:
    """Compute the surface of a material, where its fraction equals its level.

    Where it borders on a material inside, the surface is left to that one, unless it is thinner than a voxel.

    Parameters
    ----------
    material : the material
    most : largest number of triangles, about

    Returns
    -------
    triangles
    """
    material = material if most is None else material.coarsened(_PAGE_VOXELS)
    grid = material.grid
    mesh = pyvista.ImageData(dimensions=grid.shape[::-1], spacing=grid.spacing[::-1], origin=grid.origin[::-1])
    mesh.point_data["fraction"] = material.fraction.ravel()
    if material.inner is not None:
        mesh.point_data["inner"] = material.inner.ravel()
    found: Any = mesh.contour([material.level], scalars="fraction", compute_normals=True)
    if material.inner is not None and material.level == 0.5:
        outer = found.threshold(0.25, scalars="inner", invert=True).extract_surface(algorithm=None)
        found = outer if outer.n_cells else found
    return found if most is None or found.n_cells <= most else found.decimate(1 - most / found.n_cells)


def colour_of(material: Material) -> str:
    """Return the colour of a material: one of eight, then their tints, then their shades.

    Parameters
    ----------
    material : the material

    Returns
    -------
    hexadecimal colour
    """
    turn, index = divmod(material.index, len(MATERIAL_COLOURS))
    other, part = _MIXED_WITH[turn % len(_MIXED_WITH)]
    return to_hex(((1 - part) * np.array(to_rgb(MATERIAL_COLOURS[index])) + part * other).tolist()).upper()


def _layout(bases: int) -> tuple[tuple[int, int], Any, list[tuple[int, int]]]:
    """Shape of the window, its groups of cells, and the place of each panel: bases, materials, scan."""
    if bases == 0:
        return (1, 1), None, [(0, 0)]
    if bases == 1:
        return (1, 3), None, [(0, 0), (0, 1), (0, 2)]
    top = [(0, [2 * i, 2 * i + 1]) for i in range(bases)]
    bottom = [(1, list(range(bases))), (1, list(range(bases, 2 * bases)))]
    return (2, 2 * bases), top + bottom, [(row, columns[0]) for row, columns in top + bottom]


def _frame(plane: Plane) -> pyvista.PolyData:
    """The edge of a layer."""
    low, high = np.array(plane.low), np.array(plane.high)
    a, b = (i for i in range(3) if "xyz"[i] != plane.axis)
    corners = np.stack([low] * 5)
    corners[1:3, a], corners[2:4, b] = high[a], high[b]
    return pyvista.MultipleLines(corners)


def _corners(ends: Limits) -> np.ndarray:
    """The eight corners of a box."""
    return np.stack(np.meshgrid(*zip(*ends, strict=True)), axis=-1).reshape(-1, 3)


def _box(ends: Limits) -> pyvista.PolyData:
    """Edges of a box."""
    (x0, y0, z0), (x1, y1, z1) = ends
    edges: Any = pyvista.Box((x0, x1, y0, y1, z0, z1)).extract_all_edges()
    return edges
