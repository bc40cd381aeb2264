"""Figures that every model of a scan has: slices, profiles, spectrum, residuals of a test view."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.truth import Truth
from phantomgen.display.figures.style import UNIT
from phantomgen.runtime.guarded import Guard, unguarded
from recon.evaluation.scoring import held_out_views
from recon.figures import run_figures as figures
from recon.gaussians.model import GaussianModel
from recon.voxel.model import Voxels


def draw_model(
    dataset: Dataset,
    truth: Truth | None,
    model: GaussianModel | Voxels,
    folder: Path,
    left_out: Sequence[str] = (),
    guard: Guard = unguarded,
    volumes: GaussianModel | Voxels | None = None,
) -> None:
    """Draw every figure that the data allow.

    Parameters
    ----------
    dataset : the scan
    truth : truth of the scan; None where it is not known
    model : reconstruction
    folder : folder for the figures
    left_out : bases of the file that the model lacks, which the titles name
    guard : context of each figure, so that one that fails does not prevent the others
    volumes : the model in voxels, where they are known already
    """
    draw_volumes(dataset, truth, model if volumes is None else volumes, folder, left_out, guard)
    with guard("drawing residuals.png"):
        _draw_residuals(dataset, model, folder / "residuals.png")


def draw_volumes(
    dataset: Dataset,
    truth: Truth | None,
    model: GaussianModel | Voxels,
    folder: Path,
    left_out: Sequence[str] = (),
    guard: Guard = unguarded,
    unit: str = UNIT,
) -> None:
    """Draw slices and profiles of the volumes, and the spectrum of the scan.

    Parameters
    ----------
    dataset, truth, model, folder, left_out, guard : see `draw_model`
    unit : thousandth of the unit of the volumes
    """
    grid = dataset.grid if truth is None else truth.grid
    names, volumes = model.basis_names, model.volume(grid)
    true = None if truth is None else truth_of(truth, names)
    for plane in ("axial", "coronal") if grid.shape[0] > 1 else ("axial",):
        with guard(f"drawing {plane}.png"):
            path = folder / f"{plane}.png"
            figures.basis_slices(volumes, true, names, grid, path, plane, left_out=left_out, unit=unit)
    with guard("drawing profiles.png"):
        figures.profiles({"result": volumes}, true, names, grid, folder / "profiles.png", unit=unit)
    with guard("drawing spectrum.png"):
        figures.spectrum(dataset.spectra, folder / "spectrum.png")


def truth_of(truth: Truth, names: Sequence[str]) -> Float[np.ndarray, "basis z y x"] | None:
    """Return the true volumes of some bases.

    Parameters
    ----------
    truth : truth of the scan
    names : names of the bases

    Returns
    -------
    coefficients [1/mm], NaN for bases that the truth lacks; None where it has none of them
    """
    known = truth.basis_names
    if not set(names) & set(known):
        return None
    nothing = np.full(truth.grid.shape, np.nan, np.float32)
    return np.stack([truth.volumes[known.index(name)] if name in known else nothing for name in names])


def _draw_residuals(dataset: Dataset, model: GaussianModel | Voxels, path: Path) -> None:
    """Draw the residuals of the first test view."""
    for view in held_out_views(dataset, model):
        taken = np.flatnonzero(view.open_beam.any(axis=(1, 2)))
        channels = [dataset.spectra.channels[c] for c in taken]
        figures.residuals(view.counts[taken], view.expected[taken], channels, path, view.away)
        break
