"""Reconstruction of a dataset by the paper's method; it does not read the truth."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.inpainting import inpainted
from phantomgen.dataset.reader import Dataset
from phantomgen.runtime.stopwatch import Stopwatch
from recon.data.measurements import Measurements, matching_bin, read_measurements
from recon.data.readout_noise import without_floor
from recon.gaussians.model import Gaussians
from recon.gaussians.optimize import Progress
from recon.gaussians.reconstruct import Reconstruction
from recon.published_methods.paper.initialize import first_gaussians, initial_volumes, units_of
from recon.published_methods.paper.learned_edge import ConditionedBasis, KEdge
from recon.published_methods.paper.optimize import fit
from recon.published_methods.paper.projections import Projections
from recon.published_methods.paper.recipe import PaperRecipe
from recon.published_methods.paper.spectral_model import EnergyGrid, SpectralModel, energy_grid
from recon.voxel.initial_volumes import initial_volumes as volumes_of_rays
from recon.voxel.initial_volumes import starting_method
from spectra.errors import InputError
from spectra.threads import without_other_pools
from spectra.transmission import Transmission


@without_other_pools()
def reconstruct_paper(
    dataset: Dataset,
    recipe: PaperRecipe,
    bases: int | None = None,
    on_stage: Callable[[str], None] = lambda name: None,
    on_step: Callable[[Progress], bool | None] = lambda progress: None,
) -> Reconstruction:
    """Fit factorised Gaussians to the training views of a dataset.

    Parameters
    ----------
    dataset : an open dataset; only ``/entry`` is read
    recipe : hyper-parameters
    bases : number of bases, 2 or 3; that of the dataset where it is None
    on_stage : called with the name of each stage when it begins
    on_step : called after each step of the fit; the fit ends early where it returns True

    Returns
    -------
    a reconstruction in the raw basis of the dataset, in which it is scored. The fit itself uses photoelectric, Compton,
    and the learned edge made orthogonal to both; `recon.published_methods.paper.learned_edge.ConditionedBasis.to_raw`
    converts back. If the overlap is large, the raw coefficients of photoelectric and Compton may be negative

    Raises
    ------
    InputError
        When the dataset has no 2 or 3 basis functions to report.
    """
    stage, grid = Stopwatch(on_stage), dataset.grid
    method = starting_method(dataset.geometry[dataset.splits["train"]], grid)
    count = len(dataset.spectra.basis.names) if bases is None else bases
    if count not in (2, 3):
        raise InputError(f"the paper's method has 2 or 3 bases, {dataset.path} has {count}: use --bases 2 or 3")
    with stage("read"):
        measured = read_measurements(dataset, dataset.splits["train"], count)
        projections = Projections.of(measured)
        energies = energy_grid(dataset.spectra, recipe.lowest_energy, recipe.highest_energy, recipe.energies)
        edge = KEdge.at(recipe.edge_start, recipe.edge_slope) if count == 3 else None
        basis = ConditionedBasis(energies.energy, energies.signal, edge, recipe.uses("conditioning"))
        used = energies if recipe.uses("polychromatic") else energies.monochromatic()
        spectral = SpectralModel(used, basis, measured.profile)
        raw = dataset.spectra.basis.evaluate(energies.energy)[:count]
    with stage(method.name):
        coarse = measured.completed().binned(matching_bin(measured.geometry, min(grid.spacing)))
        counts_something = (coarse.gains > 0).any(axis=(1, 2))
        lowest = int(np.argmin(np.where(counts_something, dataset.spectra.effective_energy, np.inf)))
        images = Projections.of(coarse).log()[:, lowest : lowest + 1].numpy()
        blind = coarse.gains[lowest] <= 0
        volume = volumes_of_rays(inpainted(images, blind), blind, coarse.geometry, grid, method)[0]
    with stage("initialize"):
        units = units_of(volume, grid, recipe)
        means = spectral.channel_means()[lowest].detach().double().numpy()
        model = first_gaussians(volume, grid, means, units, recipe)
        start = np.einsum("mzyx,mr->rzyx", initial_volumes(volume, means, units, recipe), basis.to_raw(raw).numpy())
    with stage("fit"):
        fit(model, projections, spectral, (measured.basis_names, raw), grid, units, recipe, on_step)
    gaussians = model.gaussians(units, basis.to_raw(raw), measured.basis_names)
    error = _node_error(measured, energies, raw, gaussians)
    return Reconstruction(gaussians, method.name, start, error, measured.transmission, stage.seconds)


def _node_error(
    measured: Measurements, energies: EnergyGrid, raw: Float[np.ndarray, "raw energy"], gaussians: Gaussians
) -> float:
    """Largest error of log projections that the midpoint rule causes on rays of the first view."""
    lengths = np.moveaxis(gaussians.line_integrals(measured.geometry[:1]).double().numpy(), 1, -1)
    lengths = measured.with_profile(lengths)[:, ::4, ::4]
    few = Transmission.from_spectrum(energies.weights, np.concatenate([raw, energies.profile]))
    whole = without_floor(measured.transmission)[0]
    return float(np.abs(few.log_projection(lengths) - whole.log_projection(lengths)).max())
