"""The figures that any model of a scan has: slices, profiles, spectrum, residuals of a test view."""

from pathlib import Path

import numpy as np

from phantomgen.dataset import Dataset
from phantomgen.dataset_truth import Truth
from recon import figures
from recon.gaussians import Gaussians
from recon.scoring import held_out_views
from recon.voxels import Voxels


def draw_model(dataset: Dataset, truth: Truth | None, model: Gaussians | Voxels, folder: Path) -> None:
    """Draw every figure that the data allow."""
    grid = dataset.grid if truth is None else truth.grid
    names, volumes = model.basis_names, model.volume(grid)
    true = truth.volumes if truth is not None and truth.basis_names == names else None
    for plane in ("axial", "coronal"):
        figures.basis_slices(volumes, true, names, grid, folder / f"{plane}.png", plane)
    figures.profiles(volumes, true, names, grid, folder / "profiles.png")
    s = dataset.spectra
    figures.spectrum(
        s.energy, s.edges, s.source, s.response, s.channels, s.basis.names, s.basis_values, folder / "spectrum.png",
        s.basis.breaks,
    )  # fmt: skip
    for view in held_out_views(dataset, model):
        taken = np.flatnonzero(view.open_beam.any(axis=(1, 2)))
        channels = [s.channels[c] for c in taken]
        figures.residuals(view.counts[taken], view.expected[taken], channels, folder / "residuals.png", view.away)
        break
