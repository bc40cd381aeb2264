"""Model files of every kind."""

import math
from pathlib import Path
from typing import Any

from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.divided.model import DividedGaussians
from recon.gaussians.model import GaussianModel, Gaussians, read_model_file
from recon.gaussians.residual.model import RESIDUAL, GaussiansWithResidual
from spectra.errors import DatasetError


def load_model(path: Path) -> GaussianModel:
    """Read a model of any kind.

    Parameters
    ----------
    path : file that `GaussianModel.save` wrote

    Returns
    -------
    Gaussians, plain or divided by planes, with a residual in voxels where the file has one

    Raises
    ------
    DatasetError
        When the file is not such a file, or is one of a later version.
    """
    header, tensors = read_model_file(path)
    schemas = (Gaussians.SCHEMA, DividedGaussians.SCHEMA, GaussiansWithResidual.SCHEMA)
    if header["schema"] not in schemas:
        known = ", ".join(map(repr, schemas))
        raise DatasetError(f"{path} was written as {header['schema']!r}, this version reads {known}")
    try:
        model = model_of(tensors, header["basis"], header)
        if not math.isfinite(header.get("width", 0.0)):
            raise ValueError("its width is not a number")
        return model
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError(f"{path}: not a Gaussian model written by recon ({error})") from error


def model_of(tensors: dict[str, Tensor], basis_names: tuple[str, ...], header: dict[str, Any]) -> GaussianModel:
    """Make a model of its arrays.

    Parameters
    ----------
    tensors : arrays by name; with ``offsets``, planes divide the Gaussians; with ``residual``, voxels add to them
    basis_names : names of the basis functions
    header : what is no array, see `GaussianModel.header`

    Returns
    -------
    the model
    """
    if "residual" in tensors:
        grid = Grid(**{name: tuple(values) for name, values in dict(header["grid"]).items()})
        places, residual = (tensors[name] for name in RESIDUAL)
        if len(places) and not 0 <= int(places.min()) <= int(places.max()) < math.prod(grid.shape):
            raise ValueError("its residual lies outside of its grid")
        others = {name: value for name, value in tensors.items() if name not in RESIDUAL}
        return GaussiansWithResidual(model_of(others, basis_names, header), places, residual, grid)
    if "offsets" in tensors:
        return DividedGaussians(**tensors, basis_names=basis_names, width=float(header["width"]))
    return Gaussians(**tensors, basis_names=basis_names)
