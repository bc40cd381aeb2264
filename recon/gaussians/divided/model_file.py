"""Model files of every kind."""

from math import isfinite
from pathlib import Path
from typing import Any

from torch import Tensor

from recon.gaussians.divided.model import DividedGaussians
from recon.gaussians.model import GaussianModel, Gaussians, read_model_file
from spectra.errors import DatasetError


def load_model(path: Path) -> GaussianModel:
    """Read a model of either kind.

    Parameters
    ----------
    path : file that `GaussianModel.save` wrote

    Returns
    -------
    Gaussians, or Gaussians that planes divide

    Raises
    ------
    DatasetError
        When the file is not such a file, or is one of a later version.
    """
    header, tensors = read_model_file(path)
    if header["schema"] not in (Gaussians.SCHEMA, DividedGaussians.SCHEMA):
        raise DatasetError(
            f"{path} was written as {header['schema']!r}, this version reads {Gaussians.SCHEMA!r} and "
            f"{DividedGaussians.SCHEMA!r}"
        )
    try:
        model = model_of(tensors, header["basis"], header)
        if not isfinite(getattr(model, "width", 0.0)):
            raise ValueError("its width is not a number")
        return model
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError(f"{path}: not a Gaussian model written by recon ({error})") from error


def model_of(tensors: dict[str, Tensor], basis_names: tuple[str, ...], header: dict[str, Any]) -> GaussianModel:
    """Make a model of its arrays.

    Parameters
    ----------
    tensors : arrays by name; with ``offsets``, planes divide the Gaussians
    basis_names : names of the basis functions
    header : what is no array, see `GaussianModel.header`

    Returns
    -------
    the model
    """
    if "offsets" in tensors:
        return DividedGaussians(**tensors, basis_names=basis_names, width=float(header["width"]))
    return Gaussians(**tensors, basis_names=basis_names)
