"""Gaussians as a ``.ply`` of 3-D Gaussian splatting, which SuperSplat, viser and others open.

Viewers blend splats one behind the other, and each splat transmits a part of the light. Colours are therefore mixed
from the bases (`recon.figures.basis_colours`), and the opacity of a splat is the attenuation of X-rays of the reference
energy along the line through its centre. The coefficients of the model are in the file as ``basis_<i>`` in 1/mm.

References
----------
.. [1] Kerbl et al. 2023, 3D Gaussian Splatting for Real-Time Radiance Field Rendering, doi:10.1145/3592433
"""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from phantomgen.runtime.disk import complete_file
from recon.figures.basis_colours import mixed_colours
from recon.gaussians.model import Gaussians
from spectra.errors import NotInstalledError

HARMONIC = 0.28209479177387814  # no unit; 1 / sqrt(4 pi), the spherical harmonic of degree 0, factor of colours
_FAINTEST, _MOST_OPAQUE = 1e-4, 0.99  # no unit; limits of opacities, so that their logit is finite; our choice


def check_ply() -> Any:
    """Import the package that writes ``.ply`` files.

    Returns
    -------
    module plyfile

    Raises
    ------
    NotInstalledError
        When plyfile is not installed.
    """
    try:
        import plyfile  # noqa: PLC0415 - an extra
    except ImportError:
        raise NotInstalledError("writing .ply needs plyfile: pip install 'spectral-ct[io]'") from None
    return plyfile


def write_ply(path: Path, gaussians: Gaussians) -> None:
    """Write Gaussians, binary, little-endian, with centres and scales in mm; a file that exists is replaced.

    Parameters
    ----------
    path : file to write
    gaussians : model

    Raises
    ------
    NotInstalledError
        When plyfile is not installed.
    StorageError
        When the file system refuses; then no file is left.
    """
    plyfile = check_ply()
    columns = splat_columns(gaussians)
    table = np.empty(len(gaussians), dtype=[(name, "<f4") for name in columns])
    for name, values in columns.items():
        table[name] = values
    bases = ", ".join(f"basis_{i} {name} 1/mm" for i, name in enumerate(gaussians.basis_names))
    comments = ["centres mm, scale log mm, rot w x y z, z is the rotation axis", bases]
    element = plyfile.PlyElement.describe(table, "vertex")
    with complete_file(path, ".ply") as beside:
        plyfile.PlyData([element], byte_order="<", comments=comments).write(str(beside))


def splat_columns(gaussians: Gaussians) -> dict[str, Float[np.ndarray, " gaussian"]]:
    """Compute the properties of the file.

    Parameters
    ----------
    gaussians : model

    Returns
    -------
    values of each property, in the order of the file
    """
    centres, scales, turns, coefficients = (
        part.detach().cpu().double().numpy()
        for part in (gaussians.centres, gaussians.log_scales, gaussians.quaternions, gaussians.coefficients)
    )
    turns = turns / np.linalg.norm(turns, axis=1, keepdims=True)
    shades = (mixed_colours(coefficients, gaussians.basis_names) - 0.5) / HARMONIC
    opacity = opacities(coefficients, scales)
    zero = np.zeros(len(gaussians))
    return {
        **dict(zip("xyz", centres.T, strict=True)),
        **dict.fromkeys(("nx", "ny", "nz"), zero),
        **{f"f_dc_{i}": shade for i, shade in enumerate(shades.T)},
        "opacity": np.log(opacity / (1 - opacity)),
        **{f"scale_{i}": scale for i, scale in enumerate(scales.T)},
        **{f"rot_{i}": turn for i, turn in enumerate(turns.T)},
        **{f"basis_{i}": values for i, values in enumerate(coefficients.T)},
    }


def opacities(
    coefficients: Float[np.ndarray, "gaussian basis"], log_scales: Float[np.ndarray, "gaussian 3"]
) -> Float[np.ndarray, " gaussian"]:
    """Compute the opacity 1 - exp(-sqrt(2 pi) s sum_m b_m), with s the geometric mean of the standard deviations.

    Parameters
    ----------
    coefficients : coefficients b [1/mm]
    log_scales : logarithm of the standard deviations [log mm]

    Returns
    -------
    opacities, at least 1e-4 and at most 0.99

    Notes
    -----
    The sum of the coefficients is the attenuation at the reference energy, or just above the K edge where that is
    higher.
    """
    depth = np.sqrt(2 * np.pi) * np.exp(log_scales.mean(axis=1)) * coefficients.sum(axis=1)
    return np.clip(-np.expm1(-depth), _FAINTEST, _MOST_OPAQUE)
