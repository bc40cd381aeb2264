"""Projector, transpose and transmission as functions of tensors, with gradients in all that is continuous."""

import torch
from jaxtyping import Float
from torch import Tensor

from phantomgen.dataset.spectral_model import Spectra
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.project import differentiable, project_transpose
from phantomgen.ops.project import project as project_float32
from phantomgen.torch.geometry import TensorGeometry
from phantomgen.torch.spectra import TensorSpectra
from spectra.differentiable import transmit_spectrum
from spectra.errors import InputError
from spectra.transmission import Transmission


def project(
    volume: Float[Tensor, "*batch z y x"], grid: Grid, geometry: Geometry | TensorGeometry
) -> Float[Tensor, "*batch view row column"]:
    """Compute line integrals of volumes, with gradients in the volumes and in the poses.

    Parameters
    ----------
    volume : values of the voxels [1/mm], with any axes before the last three: batch, basis. In float64 all is computed
        by plain torch, with derivatives of any order, some hundred times slower and with memory for rays x layers of a
        view; in any other precision by kernels in float32
    grid : the voxels
    geometry : poses; gradients reach the vectors of a `TensorGeometry`

    Returns
    -------
    line integrals without unit, float64 or float32, on the device of `volume`

    Raises
    ------
    InputError
        When the volume does not fit the grid.

    Notes
    -----
    The gradient in the poses is that of the projector itself, not of an exact line integral. Joseph's method is
    continuous in the poses except where the axis that a ray crosses fastest changes; these jumps are left out.

    Examples
    --------
    >>> volume = torch.zeros(2, *grid.shape, requires_grad=True)  # doctest: +SKIP
    >>> project(volume, grid, geometry).shape  # doctest: +SKIP
    torch.Size([2, 90, 128, 128])
    """
    poses, panel = TensorGeometry.of(geometry), geometry.panel
    if tuple(volume.shape[-3:]) != grid.shape:
        shape = tuple(volume.shape)
        raise InputError(f"a volume on a grid of shape {grid.shape} must end with these axes, got {shape}")
    flat = volume.reshape(-1, *grid.shape)
    if volume.dtype == torch.float64:
        images = _project_float64(flat, grid, poses)
    else:
        images = project_float32(flat, grid, poses.frames(), panel.rows, panel.columns, poses.is_parallel)
    return images.reshape(*volume.shape[:-3], *images.shape[1:])


def back_project(
    images: Float[Tensor, "*batch view row column"], grid: Grid, geometry: Geometry | TensorGeometry
) -> Float[Tensor, "*batch z y x"]:
    """Apply the exact transpose of `project`, with gradients in the images and in the poses.

    Parameters
    ----------
    images : values of the pixels, with any axes before the last three; float64 and others as in `project`
    grid : the voxels
    geometry : poses

    Returns
    -------
    volumes; weights have the unit mm

    Raises
    ------
    InputError
        When the images do not fit the poses.
    """
    poses, panel = TensorGeometry.of(geometry), geometry.panel
    expected = len(poses), panel.rows, panel.columns
    if tuple(images.shape[-3:]) != expected:
        raise InputError(f"images of these poses must end with the axes {expected}, got {tuple(images.shape)}")
    flat = images.reshape(-1, *expected)
    if images.dtype == torch.float64:
        nothing = flat.new_zeros(len(flat), *grid.shape)
        transpose = torch.func.vjp(lambda volume: _project_float64(volume, grid, poses), nothing)[1]
        (volume,) = transpose(flat)
    else:
        volume = project_transpose(flat, grid, poses.frames(), poses.is_parallel)
    return volume.reshape(*images.shape[:-3], *grid.shape)


def transmit(
    line_integrals: Float[Tensor, "*batch column view row pixel"], spectra: Spectra | Transmission | TensorSpectra
) -> Float[Tensor, "*batch view channel row pixel"]:
    """Compute expected counts sum_E w_c(E) exp(-sum_m B_m(E) L_m), with gradients in line integrals and spectrum.

    Parameters
    ----------
    line_integrals : one image per column of the spectral model and view, (..., basis, view, row, column), as `project`
        gives them for volumes (..., basis, z, y, x)
    spectra : spectral model; gradients reach the tensors of a `TensorSpectra`

    Returns
    -------
    counts at exposure 1, (..., view, channel, row, column), the order of ``dataset.load()``

    Raises
    ------
    InputError
        When there is not one image per column.
    """
    tensors = TensorSpectra.of(spectra)
    columns = len(tensors.columns)
    if line_integrals.ndim < 4 or line_integrals.shape[-4] != columns:
        shape = tuple(line_integrals.shape)
        raise InputError(
            f"line integrals must be (..., basis, view, row, column) with {columns} columns of the spectral model, "
            f"which are its basis functions and the parts of its beam profile, got {shape}"
        )
    counts = transmit_spectrum(line_integrals.movedim(-4, -1), tensors.columns, tensors.weights)
    return counts.movedim(-1, -3)


def expected_counts(
    volume: Float[Tensor, "*batch basis z y x"],
    grid: Grid,
    geometry: Geometry | TensorGeometry,
    spectra: Spectra | Transmission | TensorSpectra,
) -> Float[Tensor, "*batch view channel row column"]:
    """Compute expected counts of basis volumes: `project`, then `transmit`.

    Parameters
    ----------
    volume : coefficients of the basis functions [1/mm]
    grid, geometry : as in `project`
    spectra : as in `transmit`

    Returns
    -------
    counts at exposure 1, (..., view, channel, row, column)
    """
    return transmit(project(volume, grid, geometry), spectra)


def _project_float64(
    volume: Float[Tensor, "component z y x"], grid: Grid, poses: TensorGeometry
) -> Float[Tensor, "component view row column"]:
    """Line integrals by plain torch."""
    frames = poses.frames().to(volume)
    spacing, origin = (frames.new_tensor(triple) for triple in (grid.spacing, grid.origin))
    begins = frames.new_tensor([not poses.is_parallel, poses.is_parallel, False, False])[:, None]
    views = (frames.flip(-1) - begins * origin) / spacing
    panel = poses.panel
    return differentiable.forward(volume, views, poses.is_parallel, spacing, panel.rows, panel.columns)
