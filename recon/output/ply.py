"""Gaussians as a ``.ply`` of 3-D Gaussian splatting, which SuperSplat, viser and others open.

Viewers blend splats one behind the other: each lets a part of the light through. So colours are mixed from the bases
(`recon.figures.basis_colours`), the opacity is what a Gaussian takes from X-rays of the reference energy on their way
through its centre, and what the model says stands beside them: ``basis_<i>`` in 1/mm.

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

HARMONIC = 0.28209479177387814  # spherical harmonic of degree 0, 1 / sqrt(4 pi)
_FAINTEST, _MOST_OPAQUE = 1e-4, 0.99  # both have a finite logarithm


def check_ply() -> Any:
    """The package that writes such files.

    Raises
    ------
    NotInstalledError
        When it is not there.
    """
    try:
        import plyfile  # noqa: PLC0415 - an extra
    except ImportError:
        raise NotInstalledError("writing .ply needs plyfile: pip install 'spectral-ct[io]'") from None
    return plyfile


def write_ply(path: Path, gaussians: Gaussians) -> None:
    """Write centres and scales in mm, binary, little-endian; a file that is there is replaced.

    Raises
    ------
    NotInstalledError
        When plyfile is not there.
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
    """Properties of the file in their order."""
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
    """1 - exp(-sqrt(2 pi) s sum_m b_m), with s the geometric mean of the standard deviations.

    The sum of the coefficients is the attenuation at the reference energy; beyond it, that of an edge just above it.
    """
    depth = np.sqrt(2 * np.pi) * np.exp(log_scales.mean(axis=1)) * coefficients.sum(axis=1)
    return np.clip(-np.expm1(-depth), _FAINTEST, _MOST_OPAQUE)
