"""The model: Gaussians in space, each with one coefficient per basis function."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.ops.rasterize import rasterize
from recon.ops.voxelize import CUTOFF, voxelize, voxelize_tensor
from spectra.errors import DatasetError

PARTS = ("centres", "log_scales", "quaternions", "coefficients")
_HEADER = "gaussians"  # key of the metadata in a file
_SCHEMA = "spectral-ct gaussians 1.0"


@dataclass(frozen=True, eq=False)
class Gaussians:
    """A sum of Gaussians that describes the attenuation of a volume.

    Parameters
    ----------
    centres : positions p_i, (N, 3) in the order x, y, z [mm]
    log_scales : logarithms of the standard deviations along the principal axes, the diagonal of S_i, (N, 3) [log mm]
    quaternions : orientations R_i, (N, 4) in the order w, x, y, z; their length does not matter [no unit]
    coefficients : values b_im at the centre for each basis, (N, M), not negative [1/mm]
    basis_names : names of the M basis functions B_m

    Notes
    -----
    The attenuation is ``mu(x, E) = sum_m B_m(E) sum_i b_im exp(-|S_i^-1 R_i^T (x - p_i)|^2 / 2)``.
    """

    centres: Float[Tensor, "gaussian 3"]
    log_scales: Float[Tensor, "gaussian 3"]
    quaternions: Float[Tensor, "gaussian 4"]
    coefficients: Float[Tensor, "gaussian basis"]
    basis_names: tuple[str, ...]

    GEOMETRY: ClassVar = ("centres", "log_scales", "quaternions")

    def __len__(self) -> int:
        return len(self.centres)

    def __repr__(self) -> str:
        return f"Gaussians({len(self)} with {', '.join(self.basis_names)})"

    def volume(self, grid: Grid) -> Float[np.ndarray, "basis z y x"]:
        """Compute the mean coefficient of each basis in every voxel.

        Parameters
        ----------
        grid : voxels to evaluate; any part of a grid gives the same values as the whole

        Returns
        -------
        volumes, (M, Z, Y, X), float32 [1/mm]
        """
        return voxelize(self.centres, self.log_scales, self.quaternions, self.coefficients, grid)

    def line_integrals(self, geometry: Geometry) -> Float[Tensor, "view basis row column"]:
        """Compute the line integrals of each basis, averaged over every pixel.

        Parameters
        ----------
        geometry : poses of the views, and the panel

        Returns
        -------
        line integrals, (V, M, R, K), differentiable in all arrays of the model [no unit]
        """
        frames = torch.from_numpy(geometry.ray_frames())
        parts = (self.centres, self.log_scales, self.quaternions, self.coefficients)
        return rasterize(*parts, frames, geometry.panel.rows, geometry.panel.columns)

    def to(self, device: torch.device | str) -> "Gaussians":
        """Copy the arrays to a device, which then computes volumes and line integrals.

        Parameters
        ----------
        device : a device of torch, such as ``cpu`` or ``cuda``

        Returns
        -------
        a model with the same values
        """
        return replace(self, **{name: value.to(device) for name, value in self.tensors().items()})

    def tensors(self) -> dict[str, Tensor]:
        """Collect the arrays.

        Returns
        -------
        `PARTS` in order, by name
        """
        return {name: getattr(self, name) for name in PARTS}

    def voxels(self, grid: Grid, cutoff: float = CUTOFF) -> Float[Tensor, "basis z y x"]:
        return voxelize_tensor(*self.tensors().values(), grid, cutoff=cutoff)

    def with_values(self, values: Tensor) -> "Gaussians":
        held = {name: getattr(self, name).detach() for name in self.GEOMETRY}
        return replace(self, **held, coefficients=values)

    def part(self, which: Tensor) -> "Gaussians":
        return replace(self, **{name: value.index_select(0, which) for name, value in self.tensors().items()})

    def detached(self) -> "Gaussians":
        """Copy the model without its gradients.

        Returns
        -------
        a model with the same values in arrays of its own
        """
        return replace(self, **{name: value.detach().clone() for name, value in self.tensors().items()})

    def save(self, path: Path) -> None:
        """Write a safetensors file whose header names axes, units and bases.

        Parameters
        ----------
        path : file to write
        """
        from safetensors.torch import save_file  # noqa: PLC0415

        header = {
            "schema": _SCHEMA,
            "basis": self.basis_names,
            "units": {"centres": "mm", "log_scales": "log mm", "coefficients": "1/mm"},
            "axes": {"centres": "x y z", "quaternions": "w x y z"},
        }
        tensors = {name: value.contiguous() for name, value in self.tensors().items()}
        # One entry: safetensors writes several in random order, and the same model must give the same bytes.
        save_file(tensors, path, metadata={_HEADER: json.dumps(header)})

    @classmethod
    def load(cls, path: Path) -> "Gaussians":
        """Read a file that `save` wrote.

        Parameters
        ----------
        path : file to read

        Returns
        -------
        the model

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
