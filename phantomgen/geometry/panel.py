"""The pixel grid of a detector: a flat panel, or flat modules side by side on a cylinder."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from spectra.errors import GeometryError, InputError


@dataclass(frozen=True)
class Curvature:
    """Curvature of a panel whose flat modules touch a cylinder in their middles.

    The axis of the cylinder is parallel to the columns of pixels, on the side of the source. Detectors of clinical
    scanners are built so, with a radius that is the distance to the source.

    Parameters
    ----------
    radius : of the cylinder [mm]
    modules : number of flat modules side by side
    """

    radius: float
    modules: int

    def __post_init__(self) -> None:
        if not 0 < self.radius < float("inf"):
            raise InputError(f"the radius of a curved panel must be positive, got {self.radius:g} mm")
        if self.modules < 1:
            raise InputError(f"a curved panel needs at least one module, got {self.modules}")


@dataclass(frozen=True)
class Panel:
    """A panel of `rows` x `columns` pixels.

    Parameters
    ----------
    rows, columns : number of pixels along each axis
    pitch : distance between pixel centres (along rows, along columns) [mm]; one number for square pixels
    curvature : of a curved panel, None for a flat one
    """

    rows: int
    columns: int
    pitch: tuple[float, float] | float
    curvature: Curvature | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.pitch, tuple):
            object.__setattr__(self, "pitch", (float(self.pitch), float(self.pitch)))
        if self.rows < 1 or self.columns < 1:
            raise InputError(f"a panel needs at least one row and one column, got {self.rows} x {self.columns}")
        if min(self.row_pitch, self.column_pitch) <= 0:
            raise InputError(f"the pixel pitch must be positive, got {self.pitch} mm")
        if self.columns % self.modules:
            raise InputError(f"{self.columns} columns cannot be divided into {self.modules} equal modules")
        if self.curvature is not None and (arc := np.ptp(self.module_angles)) >= np.pi / 2:
            raise InputError(
                f"a panel of {self.columns * self.column_pitch:g} mm on a cylinder with a radius of "
                f"{self.curvature.radius:g} mm turns by {np.rad2deg(arc):.0f} degrees: at most 90 are possible"
            )

    @property
    def row_pitch(self) -> float:
        """Distance between neighbouring rows [mm]."""
        return self.pitch[0]  # type: ignore[index]

    @property
    def column_pitch(self) -> float:
        """Distance between neighbouring columns [mm]."""
        return self.pitch[1]  # type: ignore[index]

    @property
    def modules(self) -> int:
        """Number of flat parts side by side, 1 for a flat panel."""
        return 1 if self.curvature is None else self.curvature.modules

    @property
    def module(self) -> "Panel":
        """One of the flat parts."""
        return replace(self, columns=self.columns // self.modules, curvature=None)

    @property
    def module_angles(self) -> Float[np.ndarray, " module"]:
        """Turn of each module about the axis of the cylinder, from that of the panel's centre [rad]."""
        if self.curvature is None:
            return np.zeros(1)
        width = self.columns // self.modules * self.column_pitch
        return (np.arange(self.modules) - (self.modules - 1) / 2) * width / self.curvature.radius


def module_columns(panel: Panel, radius: float, tolerance: float = 0.01) -> int:
    """Find the widest modules that keep all pixels close to where they lie on the cylinder.

    A flat module of half width w leaves the cylinder by up to w^2 / (2 r) [mm]. Rays of a source at the distance r then
    miss columns by w^3 / (3 r^2), and rows at the height h by h w^2 / (2 r^2).

    Parameters
    ----------
    panel : pixel grid
    radius : of the cylinder [mm]
    tolerance : largest distance from the place on the cylinder [pixel]

    Returns
    -------
    columns of a module; a divisor of the panel's columns
    """
    height = panel.rows * panel.row_pitch / 2
    for columns in range(panel.columns, 1, -1):
        if panel.columns % columns == 0:
            half = columns * panel.column_pitch / 2
            across = half**3 / (3 * radius**2) / panel.column_pitch
            along = height * half**2 / (2 * radius**2) / panel.row_pitch
            if max(across, along) <= tolerance:
                return columns
    return 1


def check_flat(panel: Panel) -> None:
    """Refuse a curved panel where only a flat one can be used.

    Parameters
    ----------
    panel : the pixel grid

    Raises
    ------
    GeometryError
        When the panel is curved.
    """
    if panel.curvature is not None:
        raise GeometryError(
            "a curved panel cannot be used here, only a flat one: make the scan without panel.curvature"
        )
