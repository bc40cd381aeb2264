"""Where the source and the panel stand in every view.

One frame for everything: right-handed, z is the rotation axis, the origin is the isocentre, lengths in mm. A view is
four vectors (the vector form that ASTRA, tomosipo and RTK also accept): the source point, the panel's centre, and the
steps to the next column and to the next row. Circular, helical and free orbits differ in these numbers only.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from phantomgen.panel import Panel
from spectra.errors import GeometryError

VectorPerView = Float[np.ndarray, "view 3"]


@dataclass(frozen=True, eq=False)
class Geometry:
    """Poses of a cone-beam scan; vectors are (x, y, z) in mm.

    Parameters
    ----------
    source : source point of each view
    panel_center : centre of the panel in each view
    column_step, row_step : vector from a pixel to its neighbour in the next column, in the next row
    panel : the pixel grid
    angles : rotation angle of each view [rad]; NaN where a view has none

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
    angles: Float[np.ndarray, " view"] = field(default_factory=lambda: np.empty(0))
    kind: str = "free"

    def __post_init__(self) -> None:
        views = np.shape(self.source)[0]
        for name in ("source", "panel_center", "column_step", "row_step"):
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
        """Circular orbit in the plane z = 0.

        Parameters
        ----------
        sod, sdd : source-to-object (rotation axis) and source-to-detector distance [mm]
        angles : position of the source, counter-clockwise from +x [rad]
        panel : the pixel grid; row 0 is on top (+z), columns run counter-clockwise
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

    def __len__(self) -> int:
        return len(self.source)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Geometry):
            return NotImplemented
        names = ("source", "panel_center", "column_step", "row_step")
        return self.panel == other.panel and all(np.array_equal(getattr(self, n), getattr(other, n)) for n in names)

    def __hash__(self) -> int:
        return hash((self.panel, self.source.tobytes(), self.panel_center.tobytes()))

    def __getitem__(self, views: slice | list[int] | np.ndarray) -> "Geometry":
        """Geometry of some of the views."""
        return Geometry(
            self.source[views],
            self.panel_center[views],
            self.column_step[views],
            self.row_step[views],
            self.panel,
            self.angles[views],
            self.kind,
        )

    def __repr__(self) -> str:
        panel = self.panel
        return f"Geometry({self.kind}: {len(self)} views, {panel.rows} x {panel.columns} pixels of {panel.pitch} mm)"

    def normals(self) -> VectorPerView:
        """Unit normal of the panel in each view (column step x row step)."""
        normal = np.cross(self.column_step, self.row_step)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        if (length == 0).any():
            raise GeometryError(f"column and row step of view {length.argmin()} are parallel or zero")
        return normal / length

    def ray_frames(self) -> Float[np.ndarray, "view 4 3"]:
        """Per view: source, d0, column step, row step, all (x, y, z) [mm].

        The ray through the point (column, row) of the panel, in pixels and possibly fractional, is
        ``source + t (d0 + column * column_step + row * row_step)`` with t = 1 on the panel; integers are pixel centres.
        """
        rows, columns = self.panel.rows, self.panel.columns
        first = self.panel_center - (columns - 1) / 2 * self.column_step - (rows - 1) / 2 * self.row_step
        return np.stack([self.source, first - self.source, self.column_step, self.row_step], axis=1)

    def binned(self, factor: int) -> "Geometry":
        """Geometry of the same panel with `factor` x `factor` pixels summed into one."""
        panel = self.panel
        if panel.rows % factor or panel.columns % factor:
            raise GeometryError(f"a panel of {panel.rows} x {panel.columns} pixels cannot be binned by {factor}")
        coarse = Panel(
            panel.rows // factor, panel.columns // factor, (panel.row_pitch * factor, panel.column_pitch * factor)
        )
        return Geometry(
            self.source,
            self.panel_center,
            self.column_step * factor,
            self.row_step * factor,
            coarse,
            self.angles,
            self.kind,
        )
