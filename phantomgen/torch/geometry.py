"""Poses as tensors: the vectors of every view, which an optimizer may change."""

from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from phantomgen.geometry.panel import Panel, check_flat
from phantomgen.geometry.poses import Geometry
from spectra.errors import InputError

# Where rays of a parallel beam begin [mm before the panel]; float64 still places them to 1e-11 mm.
_BEFORE = 1e5
_VECTORS = ("source", "panel_center", "column_step", "row_step")


@dataclass(frozen=True, eq=False)
class TensorGeometry:
    """Poses of source and panel in every view, as tensors (view, 3) in float64; vectors are (x, y, z) in mm.

    Any of the tensors may carry a gradient.

    Parameters
    ----------
    source : source point of each view; has no effect in a parallel beam
    panel_center : centre of the panel in each view
    column_step, row_step : vector from a pixel to its neighbour in the next column, in the next row
    panel : the pixel grid; its pitch has no effect, the steps have
    ray_direction : unit vector along the rays of each view of a parallel beam, None where rays leave a source

    Raises
    ------
    InputError
        When a tensor is not one vector per view.
    GeometryError
        When the panel is curved.
    """

    source: Float[Tensor, "view 3"]
    panel_center: Float[Tensor, "view 3"]
    column_step: Float[Tensor, "view 3"]
    row_step: Float[Tensor, "view 3"]
    panel: Panel
    ray_direction: Float[Tensor, "view 3"] | None = None

    def __post_init__(self) -> None:
        check_flat(self.panel)
        for name in (*_VECTORS, *(() if self.ray_direction is None else ("ray_direction",))):
            shape = tuple(getattr(self, name).shape)
            if shape != (len(self.source), 3):
                raise InputError(f"geometry {name} has shape {shape}, expected (view, 3) with {len(self.source)} views")

    @classmethod
    def of(cls, geometry: "Geometry | TensorGeometry", device: torch.device | str = "cpu") -> "TensorGeometry":
        """Create tensors from poses.

        Parameters
        ----------
        geometry : poses; tensors are returned as they are
        device : of the new tensors

        Returns
        -------
        poses as tensors without gradients
        """
        if isinstance(geometry, TensorGeometry):
            return geometry
        direction = geometry.ray_direction
        vectors = {name: torch.tensor(getattr(geometry, name), device=device) for name in _VECTORS}
        along = None if direction is None else torch.tensor(direction, device=device)
        return cls(**vectors, panel=geometry.panel, ray_direction=along)

    def __len__(self) -> int:
        return len(self.source)

    def __getitem__(self, views: Any) -> "TensorGeometry":
        """Poses of some of the views: a slice, or a list or tensor of numbers."""
        direction = None if self.ray_direction is None else self.ray_direction[views]
        return replace(self, **{name: getattr(self, name)[views] for name in _VECTORS}, ray_direction=direction)

    def __repr__(self) -> str:
        return f"TensorGeometry({len(self)} views, {self.panel.rows} x {self.panel.columns} pixels)"

    @property
    def is_parallel(self) -> bool:
        """True when all rays of a view are parallel."""
        return self.ray_direction is not None

    def shifted(self, columns: Tensor | float = 0.0, rows: Tensor | float = 0.0) -> "TensorGeometry":
        """Shift the panel in its plane.

        Parameters
        ----------
        columns, rows : shift along the columns and along the rows [pixel], one number or one per view

        Returns
        -------
        poses that carry the gradients of the shifts
        """
        by = [torch.as_tensor(shift).to(self.panel_center).reshape(-1, 1) for shift in (columns, rows)]
        return replace(self, panel_center=self.panel_center + by[0] * self.column_step + by[1] * self.row_step)

    def frames(self) -> Float[Tensor, "view 4 3"]:
        """Compute the ray frames that `phantomgen.ops.project.project` takes.

        Returns
        -------
        frames, (view, 4, 3), with the gradients of the vectors
        """
        columns, rows = (self.panel.columns - 1) / 2, (self.panel.rows - 1) / 2
        first = self.panel_center - columns * self.column_step - rows * self.row_step
        if self.ray_direction is None:
            begin, way = self.source, first - self.source
        else:
            begin, way = _BEFORE * self.ray_direction, first - _BEFORE * self.ray_direction
        return torch.stack([begin, way, self.column_step, self.row_step], dim=1)

    def numpy(self) -> Geometry:
        """Return the poses without gradients.

        Returns
        -------
        poses as arrays
        """
        vectors = {name: getattr(self, name).detach().cpu().numpy() for name in _VECTORS}
        if self.ray_direction is None:
            return Geometry(**vectors, panel=self.panel)
        del vectors["source"]
        return Geometry.parallel(self.ray_direction.detach().cpu().numpy(), **vectors, panel=self.panel)
