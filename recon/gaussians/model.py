"""The model: Gaussians in space that carry one coefficient per basis function."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.ops.rasterize import rasterize
from recon.ops.voxelize import voxelize
from spectra.errors import DatasetError

PARTS = ("centres", "log_scales", "quaternions", "coefficients")
_HEADER = "gaussians"  # key of the metadata in a file
_SCHEMA = "spectral-ct gaussians 1.0"


@dataclass(frozen=True, eq=False)
class Gaussians:
    """Sums of Gaussians that describe the attenuation of a volume.

    The model is ``mu(x, E) = sum_m B_m(E) sum_i b_im exp(-|S_i^-1 R_i^T (x - p_i)|^2 / 2)``.

    Parameters
    ----------
    centres : p, (x, y, z) [mm]
    log_scales : logarithm of the standard deviations along the principal axes [log mm]
    quaternions : orientation R (w, x, y, z)
    coefficients : b, value at the centre per basis, in the raw basis and never negative [1/mm]
    basis_names : names of the basis functions B
    """

    centres: Float[Tensor, "gaussian 3"]
    log_scales: Float[Tensor, "gaussian 3"]
    quaternions: Float[Tensor, "gaussian 4"]
    coefficients: Float[Tensor, "gaussian basis"]
    basis_names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.centres)

    def __repr__(self) -> str:
        return f"Gaussians({len(self)} with {', '.join(self.basis_names)})"

    def volume(self, grid: Grid) -> Float[np.ndarray, "basis z y x"]:
        """Voxel means of every basis [1/mm]."""
        return voxelize(self.centres, self.log_scales, self.quaternions, self.coefficients, grid)

    def line_integrals(self, geometry: Geometry) -> Float[Tensor, "view basis row column"]:
        """Line integrals of every basis through every pixel, averaged over the pixel [no unit]."""
        frames = torch.from_numpy(geometry.ray_frames())
        parts = (self.centres, self.log_scales, self.quaternions, self.coefficients)
        return rasterize(*parts, frames, geometry.panel.rows, geometry.panel.columns)

    def to(self, device: torch.device | str) -> "Gaussians":
        """The same values on a device, which then computes whatever is asked of them."""
        return replace(self, **{name: value.to(device) for name, value in self.tensors().items()})

    def tensors(self) -> dict[str, Tensor]:
        """All arrays by name."""
        return {name: getattr(self, name) for name in PARTS}

    def detached(self) -> "Gaussians":
        """The same values without a graph."""
        return replace(self, **{name: value.detach().clone() for name, value in self.tensors().items()})

    def save(self, path: Path) -> None:
        """Write a safetensors file; its header says axes, units and bases."""
        from safetensors.torch import save_file  # noqa: PLC0415

        header = {
            "schema": _SCHEMA,
            "basis": self.basis_names,
            "units": {"centres": "mm", "log_scales": "log mm", "coefficients": "1/mm"},
            "axes": {"centres": "x y z", "quaternions": "w x y z"},
        }
        tensors = {name: value.contiguous() for name, value in self.tensors().items()}
        # One entry, as safetensors writes several in random order, and the same model shall give the same bytes.
        save_file(tensors, path, metadata={_HEADER: json.dumps(header)})

    @classmethod
    def load(cls, path: Path) -> "Gaussians":
        """Read a file that `save` wrote.

        Raises
        ------
        DatasetError
            When the file is not such a file.
        """
        from safetensors import SafetensorError, safe_open  # noqa: PLC0415

        try:
            with safe_open(path, framework="pt") as file:
                header = json.loads((file.metadata() or {})[_HEADER])
                tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a dict
            if header["schema"] != _SCHEMA:
                raise DatasetError(f"{path} was written as {header['schema']!r}, this version reads {_SCHEMA!r}")
            return cls(**tensors, basis_names=tuple(header["basis"]))
        except DatasetError:
            raise
        except (OSError, SafetensorError, KeyError, TypeError, ValueError) as error:
            raise DatasetError(f"{path}: not a Gaussian model written by recon ({error})") from error
