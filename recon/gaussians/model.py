"""Models of an object: sums of Gaussians in space, with coefficients for every basis function."""

import json
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Tensor

from phantomgen.geometry.curved_panel import module_frames
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.runtime.disk import one_sentence
from recon.ops.rasterize import rasterize
from recon.ops.voxelize import CUTOFF, voxelize, voxelize_tensor
from spectra.errors import DatasetError

HEADER = "gaussians"  # key of the metadata in a file
Model = TypeVar("Model", bound="GaussianModel")  # in place of `Self`, which beartype takes in classes it decorates only


class GaussianModel(ABC):
    """What every sum of Gaussians gives: volumes, line integrals, its arrays, and a file.

    Attributes
    ----------
    GEOMETRY : names of the arrays that place and shape the Gaussians
    SIGNED : whether single coefficients may be negative
    LEAST_CUTOFF : smallest cutoff at which sums of the Gaussians hold what they were fitted to [standard deviations]
    SCHEMA : what a file of the model calls itself
    basis_names : names of the M basis functions B_m
    coefficients : the last axis is that of the bases [1/mm]
    """

    GEOMETRY: ClassVar[tuple[str, ...]]
    SIGNED: ClassVar[bool]
    LEAST_CUTOFF: ClassVar[float]
    SCHEMA: ClassVar[str]
    UNITS: ClassVar[dict[str, str]]
    basis_names: tuple[str, ...]
    centres: Float[Tensor, "gaussian 3"]
    log_scales: Float[Tensor, "gaussian 3"]
    coefficients: Float[Tensor, "gaussian *side basis"]

    def __len__(self) -> int:
        return len(self.centres)

    @property
    @abstractmethod
    def numbers(self) -> int:
        """Count the numbers that describe the model."""

    @abstractmethod
    def voxels(self, grid: Grid, cutoff: float = CUTOFF) -> Float[Tensor, "basis z y x"]:
        """Compute the mean coefficient of each basis in every voxel.

        Parameters
        ----------
        grid : voxels to evaluate
        cutoff : where Gaussians end [standard deviations]

        Returns
        -------
        volumes, (M, Z, Y, X), differentiable in all arrays of the model [1/mm]
        """

    @abstractmethod
    def volume(self, grid: Grid) -> Float[np.ndarray, "basis z y x"]:
        """Compute the mean coefficient of each basis in every voxel.

        Parameters
        ----------
        grid : voxels to evaluate; any part of a grid gives the same values as the whole

        Returns
        -------
        volumes, (M, Z, Y, X), float32, not negative [1/mm]
        """

    @abstractmethod
    def line_integrals(self, geometry: Geometry) -> Float[Tensor, "view basis row column"]:
        """Compute the line integrals of each basis, averaged over every pixel.

        Parameters
        ----------
        geometry : poses of the views, and the panel

        Returns
        -------
        line integrals, (V, M, R, K), differentiable in all arrays of the model [no unit]
        """

    @abstractmethod
    def plain(self) -> "Gaussians":
        """Describe the model by Gaussians alone, for what knows nothing else.

        Returns
        -------
        Gaussians of the same mass, centre and covariance; the model itself where it has nothing but Gaussians
        """

    def header(self) -> dict[str, Any]:
        """Collect what is no array.

        Returns
        -------
        values by the name of their field, besides `basis_names`
        """
        return {}

    def tensors(self) -> dict[str, Tensor]:
        """Collect the arrays.

        Returns
        -------
        those of `GEOMETRY` in order, then the coefficients, by name
        """
        return {name: getattr(self, name) for name in (*self.GEOMETRY, "coefficients")}

    def with_tensors(self: Model, tensors: dict[str, Tensor]) -> Model:
        """Make the same model of other arrays.

        Parameters
        ----------
        tensors : arrays by name; those that are missing stay

        Returns
        -------
        a model with these arrays
        """
        return replace(self, **tensors)  # type: ignore[type-var]

    def with_values(self: Model, values: Float[Tensor, "gaussian *side value"]) -> Model:
        """Replace the coefficients, and hold the geometry.

        Parameters
        ----------
        values : other coefficients, any number of them in place of one per basis

        Returns
        -------
        a model whose volumes and line integrals are linear in `values`
        """
        held = {name: getattr(self, name).detach() for name in self.GEOMETRY}
        return self.with_tensors(held | {"coefficients": values})

    def part(self: Model, which: Int64[Tensor, " some"]) -> Model:
        """Select some of the Gaussians.

        Parameters
        ----------
        which : their indices

        Returns
        -------
        a model of these, differentiable in the arrays of the whole
        """
        return self.with_tensors({name: value.index_select(0, which) for name, value in self.tensors().items()})

    def to(self: Model, device: torch.device | str) -> Model:
        """Copy the arrays to a device, which then computes volumes and line integrals.

        Parameters
        ----------
        device : a device of torch, such as ``cpu`` or ``cuda``

        Returns
        -------
        a model with the same values
        """
        return self.with_tensors({name: value.to(device) for name, value in self.tensors().items()})

    def detached(self: Model) -> Model:
        """Copy the model without its gradients.

        Returns
        -------
        a model with the same values in arrays of its own
        """
        return self.with_tensors({name: value.detach().clone() for name, value in self.tensors().items()})

    def save(self, path: Path) -> None:
        """Write a safetensors file whose header names axes, units and bases.

        Parameters
        ----------
        path : file to write

        Raises
        ------
        StorageError
            When the disk is full or refuses.
        """
        from safetensors.torch import save  # noqa: PLC0415

        header = {
            "schema": self.SCHEMA,
            "basis": self.basis_names,
            "units": self.UNITS,
            "axes": {"centres": "x y z", "quaternions": "w x y z"},
        }
        tensors = {name: value.contiguous() for name, value in self.tensors().items()}
        # One entry: safetensors writes several in random order, and the same model must give the same bytes.
        packed = save(tensors, metadata={HEADER: json.dumps(header | self.header())})
        with one_sentence(path):
            path.write_bytes(packed)  # with the rights of other files; safetensors writes files for the owner alone


@dataclass(frozen=True, eq=False)
class Gaussians(GaussianModel):
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
    SIGNED: ClassVar = False
    LEAST_CUTOFF: ClassVar = 0.0
    SCHEMA: ClassVar = "spectral-ct gaussians 1.0"
    UNITS: ClassVar = {"centres": "mm", "log_scales": "log mm", "coefficients": "1/mm"}

    def __repr__(self) -> str:
        return f"Gaussians({len(self)} with {', '.join(self.basis_names)})"

    @property
    def numbers(self) -> int:
        """Count the numbers that describe the model: 10 + M for each Gaussian."""
        return len(self) * (10 + self.coefficients.shape[1])

    def voxels(self, grid: Grid, cutoff: float = CUTOFF) -> Float[Tensor, "basis z y x"]:
        """Compute the mean coefficient of each basis in every voxel.

        Parameters
        ----------
        grid : voxels to evaluate
        cutoff : where Gaussians end [standard deviations]

        Returns
        -------
        volumes, (M, Z, Y, X), differentiable in all arrays of the model [1/mm]
        """
        return voxelize_tensor(self.centres, self.log_scales, self.quaternions, self.coefficients, grid, cutoff=cutoff)

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
        frames = torch.from_numpy(module_frames(geometry))
        parts = (self.centres, self.log_scales, self.quaternions, self.coefficients)
        return rasterize(*parts, frames, geometry.panel.rows, geometry.panel.columns)

    def plain(self) -> "Gaussians":
        """Return the model itself, which has nothing but Gaussians.

        Returns
        -------
        the model
        """
        return self

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
        header, tensors = read_model_file(path)
        if header["schema"] != cls.SCHEMA:
            raise DatasetError(f"{path} was written as {header['schema']!r}, this reader takes {cls.SCHEMA!r}")
        try:
            return cls(**tensors, basis_names=header["basis"])
        except TypeError as error:
            raise DatasetError(f"{path}: not a Gaussian model written by recon ({error})") from error


_LARGEST_LOG = 30.0  # of a standard deviation in mm: 1e13 mm, or 1e-13 mm
PARTS = (*Gaussians.GEOMETRY, "coefficients")  # names of the arrays of `Gaussians`, in order


def read_model_file(path: Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """Read the header and the arrays of a model.

    Parameters
    ----------
    path : file that `GaussianModel.save` wrote

    Returns
    -------
    header with at least ``schema`` and ``basis``; arrays by name

    Raises
    ------
    DatasetError
        When the file is not such a file.
    """
    from safetensors import SafetensorError, safe_open  # noqa: PLC0415

    try:
        with safe_open(path, framework="pt") as file:
            header = json.loads((file.metadata() or {})[HEADER])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a dict
        found = header | {"schema": str(header["schema"]), "basis": tuple(map(str, header["basis"]))}
    except (OSError, SafetensorError, KeyError, TypeError, ValueError) as error:
        raise DatasetError(f"{path}: not a Gaussian model written by recon ({error})") from error
    _check_arrays(path, tensors, len(found["basis"]))
    return found, tensors


def _check_arrays(path: Path, tensors: dict[str, Tensor], bases: int) -> None:
    """Refuse arrays that do not fit together, or hold values that are not numbers."""
    count = len(tensors["centres"]) if tensors.get("centres", torch.empty(())).ndim else -1
    sides = (2,) if "offsets" in tensors else ()
    shapes = {"centres": (count, 3), "log_scales": (count, 3), "quaternions": (count, 4), "offsets": (count,)}
    shapes["coefficients"] = (count, *sides, bases)
    if "residual" in tensors or "places" in tensors:
        voxels = len(tensors["places"]) if tensors.get("places", torch.empty(())).ndim else -1
        shapes |= {"places": (voxels,), "residual": (voxels, bases)}
    for name, values in tensors.items():
        whole = name == "places"
        right = values.dtype == torch.int64 if whole else values.is_floating_point()
        if not right or tuple(values.shape) != shapes.get(name, tuple(values.shape)):
            raise DatasetError(
                f"{path} is damaged: {name} has shape {tuple(values.shape)} and type {values.dtype}, expected "
                f"{'whole' if whole else 'floating point'} numbers of shape {shapes.get(name)}"
            )
        if not torch.isfinite(values).all():
            raise DatasetError(f"{path} is damaged: {name} holds a value that is not a number; run recon fit again")
    if len(tensors.get("log_scales", ())) and float(tensors["log_scales"].abs().max()) > _LARGEST_LOG:
        raise DatasetError(f"{path} is damaged: a Gaussian has a standard deviation beyond any scan; fit again")
