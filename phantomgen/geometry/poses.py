"""Poses of source and panel in every view.

One frame for everything: right-handed, z is the rotation axis, the origin is the isocentre, lengths in mm. A view is
four vectors (the vector form that ASTRA, tomosipo and RTK also accept): the source point, the panel's centre, and the
steps to the next column and to the next row; of a curved panel the steps at its centre. Circular, helical, parallel
and free orbits differ in these numbers only; `phantomgen.geometry.orbits` makes them.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.panel import Panel, check_flat
from phantomgen.geometry.voxel_grid import Grid
from spectra.errors import GeometryError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

VectorPerView = Float[np.ndarray, "view 3"]
# Rays of a parallel beam start on a source so far from the panel [mm]. Chords of a sphere of 80 mm, 300 mm before the
# panel and up to 100 mm beside the central ray, then err by 4e-5 mm rms, at worst 2e-4 mm, because rays are not quite
# parallel, and by 1e-7 mm from rounding. From 1e10 on rounding shows in pixels of 3 um, below 1e9 in long chords.
FAR = 1e9


@dataclass(frozen=True, eq=False)
class Geometry:
    """Geometry of a scan: poses of source and panel in every view; vectors are (x, y, z) in mm.

    Parameters
    ----------
    source : source point of each view
    panel_center : centre of the panel in each view
    column_step, row_step : vector from a pixel to its neighbour in the next column, in the next row
    panel : the pixel grid
    angles : rotation angle of each view [rad]; NaN where a view has none
    kind : ``circular``, ``helical``, ``laminography``, ``parallel`` or ``free``; a name, from which nothing follows
    ray_direction : unit vector along the rays of each view of a parallel beam, None where rays leave a source

    Raises
    ------
    GeometryError
        When shapes disagree, values are not finite, or a source lies in its panel's plane.
    """

    source: VectorPerView
    panel_center: VectorPerView
    column_step: VectorPerView
    row_step: VectorPerView
    panel: Panel
    angles: Float[np.ndarray, " view"] | Float[np.ndarray, "0"] = field(default_factory=lambda: np.empty(0))
    kind: str = "free"
    ray_direction: VectorPerView | None = None

    def __post_init__(self) -> None:
        views = np.shape(self.source)[0]
        for name in (*_VECTORS, *(() if self.ray_direction is None else ("ray_direction",))):
            value = np.ascontiguousarray(getattr(self, name), dtype=np.float64)
            if value.shape != (views, 3):
                raise GeometryError(f"geometry {name} has shape {value.shape}, expected ({views}, 3)")
            if not np.isfinite(value).all():
                raise GeometryError(f"geometry {name} holds a value that is not finite")
            object.__setattr__(self, name, value)
        if np.size(self.angles) == 0:
            object.__setattr__(self, "angles", np.full(views, np.nan))
        height = np.einsum("vi,vi->v", self.panel_center - self.source, self.normals())
        if views and np.abs(height).min() < 1e-9:
            raise GeometryError(f"the source of view {np.abs(height).argmin()} lies in the plane of its panel")

    @classmethod
    def circular(cls, sod: float, sdd: float, angles: Float[np.ndarray, " view"], panel: Panel) -> "Geometry":
        """Create a circular orbit in the plane z = 0.

        Parameters
        ----------
        sod, sdd : source-to-object (rotation axis) and source-to-detector distance [mm]
        angles : position of the source, counter-clockwise from +x [rad]
        panel : the pixel grid; row 0 is on top (+z), columns run counter-clockwise

        Returns
        -------
        poses of all views

        Raises
        ------
        GeometryError
            When the distances are impossible.
        """
        if not 0 < sod < sdd:
            raise GeometryError(f"a circular orbit needs 0 < sod < sdd, got sod {sod:g} mm and sdd {sdd:g} mm")
        angles = np.asarray(angles, dtype=np.float64)
        zero, one = np.zeros_like(angles), np.ones_like(angles)
        radial = np.stack([np.cos(angles), np.sin(angles), zero], axis=1)
        tangent = np.stack([-np.sin(angles), np.cos(angles), zero], axis=1)
        down = np.stack([zero, zero, -one], axis=1)
        return cls(
            source=sod * radial,
            panel_center=(sod - sdd) * radial,
            column_step=panel.column_pitch * tangent,
            row_step=panel.row_pitch * down,
            panel=panel,
            angles=angles,
            kind="circular",
        )

    @classmethod
    def parallel(
        cls,
        ray_direction: VectorPerView,
        panel_center: VectorPerView,
        column_step: VectorPerView,
        row_step: VectorPerView,
        panel: Panel,
        angles: Float[np.ndarray, " view"] | None = None,
    ) -> "Geometry":
        """Create views in a parallel beam: rays from a source at a distance of `FAR` from the panel.

        Parameters
        ----------
        ray_direction : unit vectors from source to panel
        panel_center, column_step, row_step, panel, angles : as of any geometry

        Returns
        -------
        poses of all views

        Raises
        ------
        GeometryError
            When the directions are no unit vectors.
        """
        ray_direction, panel_center = (np.asarray(a, dtype=np.float64) for a in (ray_direction, panel_center))
        length = np.linalg.norm(ray_direction, axis=-1)
        if not np.allclose(length, 1.0, rtol=0, atol=1e-6):
            raise GeometryError(f"directions of rays must be unit vectors, got one of length {length.max():g}")
        return cls(
            source=panel_center - FAR * ray_direction,
            panel_center=panel_center,
            column_step=column_step,
            row_step=row_step,
            panel=panel,
            angles=np.empty(0) if angles is None else angles,
            kind="parallel",
            ray_direction=ray_direction,
        )

    def __len__(self) -> int:
        return len(self.source)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Geometry):
            return NotImplemented
        if self.panel != other.panel or self.is_parallel != other.is_parallel:
            return False
        return all(np.array_equal(getattr(self, name), getattr(other, name)) for name in _VECTORS)

    def __hash__(self) -> int:
        return hash((self.panel, self.source.tobytes(), self.panel_center.tobytes()))

    def __getitem__(self, views: slice | list[int] | np.ndarray) -> "Geometry":
        """Geometry of some of the views."""
        vectors = {name: getattr(self, name)[views] for name in _VECTORS}
        direction = None if self.ray_direction is None else self.ray_direction[views]
        return replace(self, **vectors, angles=self.angles[views], ray_direction=direction)

    def __repr__(self) -> str:
        panel = self.panel
        curved = "" if panel.curvature is None else f", radius {panel.curvature.radius:g} mm"
        pixels = f"{panel.rows} x {panel.columns} pixels of {panel.pitch} mm{curved}"
        return f"Geometry({self.kind}: {len(self)} views, {pixels})"

    @property
    def is_parallel(self) -> bool:
        """True when all rays of a view are parallel."""
        return self.ray_direction is not None

    def moved(self, turns: Float[np.ndarray, "view 3 3"], shifts: VectorPerView) -> "Geometry":
        """Turn source and panel of each view about the isocentre, then shift them.

        Parameters
        ----------
        turns : rotation of each view, (view, 3, 3)
        shifts : vector of each view [mm], (view, 3)

        Returns
        -------
        moved poses
        """

        def turned(vectors: VectorPerView) -> VectorPerView:
            return np.einsum("vij,vj->vi", turns, vectors)

        center, direction = turned(self.panel_center) + shifts, self.ray_direction
        if direction is not None:
            direction = turned(direction)
        return replace(
            self,
            source=turned(self.source) + shifts if direction is None else center - FAR * direction,
            panel_center=center,
            column_step=turned(self.column_step),
            row_step=turned(self.row_step),
            ray_direction=direction,
        )

    def normals(self) -> VectorPerView:
        """Compute the unit normal of the panel in each view (column step x row step).

        Returns
        -------
        unit vectors, (view, 3)

        Raises
        ------
        GeometryError
            When the steps of a view are parallel or zero.
        """
        normal = np.cross(self.column_step, self.row_step)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        if (length == 0).any():
            raise GeometryError(f"column and row step of view {length.argmin()} are parallel or zero")
        return normal / length

    def ray_frames(self) -> Float[np.ndarray, "view 4 3"]:
        """Compute the ray frame of each view: source, d0, column step, row step, all (x, y, z) [mm].

        The ray through the point (column, row) of the panel, in pixels and possibly fractional, is
        ``source + t (d0 + column * column_step + row * row_step)`` with t = 1 on the panel; integers are pixel centres.

        Returns
        -------
        frames, (view, 4, 3)

        Raises
        ------
        GeometryError
            When the panel is curved: `phantomgen.geometry.curved_panel.module_frames` has a frame for each module.
        """
        check_flat(self.panel)
        rows, columns = self.panel.rows, self.panel.columns
        first = self.panel_center - (columns - 1) / 2 * self.column_step - (rows - 1) / 2 * self.row_step
        return np.stack([self.source, first - self.source, self.column_step, self.row_step], axis=1)

    def binned(self, factor: int) -> "Geometry":
        """Return the geometry of the same panel with `factor` x `factor` pixels summed into one.

        Parameters
        ----------
        factor : pixels along each side

        Returns
        -------
        poses with larger pixels

        Raises
        ------
        GeometryError
            When the panel cannot be divided by the factor.
        """
        panel = self.panel
        if panel.rows % factor or panel.columns % factor:
            raise GeometryError(f"a panel of {panel.rows} x {panel.columns} pixels cannot be binned by {factor}")
        if panel.columns // panel.modules % factor:
            columns = panel.columns // panel.modules
            raise GeometryError(f"modules of {columns} columns of a curved panel cannot be binned by {factor}")
        pitch = (panel.row_pitch * factor, panel.column_pitch * factor)
        coarse = Panel(panel.rows // factor, panel.columns // factor, pitch, panel.curvature)
        return replace(self, column_step=self.column_step * factor, row_step=self.row_step * factor, panel=coarse)

    def subdivided(self, factor: int) -> "Geometry":
        """Return the geometry of the same panel with each pixel divided into `factor` x `factor`.

        Parameters
        ----------
        factor : parts along each side of a pixel

        Returns
        -------
        poses with smaller pixels
        """
        panel = self.panel
        pitch = (panel.row_pitch / factor, panel.column_pitch / factor)
        fine = Panel(panel.rows * factor, panel.columns * factor, pitch, panel.curvature)
        return replace(self, column_step=self.column_step / factor, row_step=self.row_step / factor, panel=fine)

    def draw(self, path: Path | str | None = None, grid: Grid | None = None) -> "Figure":
        """Draw the scan: from above, from the side, and the panel as the source sees it.

        Parameters
        ----------
        path : PNG, PDF or SVG to write; none is written where left out
        grid : a volume to draw with it

        Returns
        -------
        the figure
        """
        from phantomgen.display.figures.geometry import draw  # noqa: PLC0415 - matplotlib only where it draws

        return draw(self, path, grid)


_VECTORS = ("source", "panel_center", "column_step", "row_step")


def distances(geometry: Geometry) -> dict[str, float | None]:
    """Compute the distances in view 0: from source to axis and to panel, and from axis to panel.

    Those to the panel are along its normal. In a helical scan the axis is met at the height of the source.

    Parameters
    ----------
    geometry : poses

    Returns
    -------
    distances by name [mm]; those from the source are None in a parallel beam
    """
    source, center, normal = geometry.source[0].copy(), geometry.panel_center[0].copy(), geometry.normals()[0]
    if geometry.kind == "helical":
        center[2] -= source[2]
        source[2] = 0.0
    near = {"sod_mm": float(np.linalg.norm(source)), "sdd_mm": float(abs((center - source) @ normal))}
    behind = {"object_to_panel_mm": float(abs(center @ normal))}
    return (dict.fromkeys(near) if geometry.is_parallel else near) | behind
