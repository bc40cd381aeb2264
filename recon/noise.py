"""Interface for Python programs: what noise does to a run, by reconstructing it anew."""

from collections.abc import Callable, Sequence
from pathlib import Path

from phantomgen.dataset.reader import Dataset, open_dataset
from phantomgen.dataset.truth import Truth
from recon.api import QuantityMap
from recon.detectability.classes import reconstruct_classes
from recon.detectability.image_quality import ImageQuality, measure
from recon.detectability.insert import Insert
from recon.readouts.fractions import named_materials
from recon.readouts.quantity import quantity
from recon.readouts.readouts import Readouts
from recon.readouts.spectrum import detected_spectrum
from recon.runs.interfaces import Unwatched
from recon.runs.read_run import open_model
from recon.uncertainty.estimate import RepeatableRun, Uncertainty, estimate, stored_replicates
from spectra.materials.material import Material


def estimate_uncertainty(
    run: Path | str,
    dataset: Dataset | Path | str,
    replicates: int = 8,
    seed: int = 0,
    on_replicate: Callable[[int], None] = lambda number: None,
) -> Uncertainty:
    """Reconstruct a run anew with other noise, and compute standard deviations, as ``recon uncertainty`` does.

    Parameters
    ----------
    run : run folder of any method with volumes, where the replicates are written
    dataset : its scan, open or its file
    replicates : number of reconstructions; those that the folder has already are not made again
    seed : of the noise
    on_replicate : called with the number of each replicate before it is made

    Returns
    -------
    standard deviation and bias of each basis, and the replicates for regions and quantities

    Raises
    ------
    DatasetError
        When the folder is no run, or the dataset is another one.
    InputError
        When the method of the run cannot be repeated.
    """
    if not isinstance(dataset, Dataset):
        with open_dataset(dataset) as opened:
            return estimate_uncertainty(run, opened, replicates, seed, on_replicate)
    return estimate(Path(run), dataset, replicates, seed, Unwatched(), on_replicate)


def estimate_detectability(
    run: Path | str,
    dataset: Dataset | Path | str,
    insert: str,
    what: str = "hu",
    energy: float | None = None,
    pairs: int = 8,
    seed: int = 0,
    on_replicate: Callable[[int], None] = lambda number: None,
    truth: Truth | None = None,
) -> ImageQuality:
    """Reconstruct a run anew with and without an insert, and compute d' of observers, as ``recon quality`` does.

    Parameters
    ----------
    run : run folder of any method with volumes, where the reconstructions are written
    dataset : its scan, open or its file
    insert : ``"X,Y,Z,RADIUS"`` for a ball or ``"X,Y,Z,RADIUS,LENGTH"`` for a rod along z [mm]
    what, energy : images that observers see, as in `readout`
    pairs : reconstructions with and without the insert; those that the folder has already are not made again
    seed : of the noise
    on_replicate : called with the number of each reconstruction before it is made
    truth : what counts are drawn from, in place of the result of the run

    Returns
    -------
    contrast, noise, spectra and d' of observers of images and of counts

    Raises
    ------
    DatasetError
        When the folder is no run, or the dataset is another one.
    InputError
        When the insert is not in the volume, or the method of the run cannot be repeated.
    """
    if not isinstance(dataset, Dataset):
        with open_dataset(dataset) as opened:
            return estimate_detectability(run, opened, insert, what, energy, pairs, seed, on_replicate, truth)
    again, place = RepeatableRun.of_run(Path(run), dataset), Insert.parse(insert)
    stored = again.stored
    shown = quantity(Readouts.of(stored.basis, *detected_spectrum(stored.basis, stored.transmission)), what, energy)
    classes = reconstruct_classes(again, place, pairs, seed, Unwatched(), on_replicate, truth)
    return measure(classes, shown)


def deviation(
    run: Path | str,
    what: str,
    energy: float | None = None,
    water: str | float | None = None,
    materials: Sequence[str | Material] = (),
) -> QuantityMap:
    """Compute the standard deviation of a quantity in every voxel, from the replicates of a run.

    Parameters
    ----------
    run : run folder, for which `estimate_uncertainty` was called
    what, energy, water, materials : the quantity, as for `readout`

    Returns
    -------
    standard deviation with the unit of the quantity, on the grid of the run

    Raises
    ------
    DatasetError
        When the run has no replicates.
    InputError
        When there is no such quantity, or the basis of the run cannot show it.
    """
    folder = Path(run)
    stored = open_model(folder)
    spectrum = detected_spectrum(stored.basis, stored.transmission)
    chosen = quantity(Readouts.of(stored.basis, *spectrum), what, energy, water, named_materials(materials))
    replicates = stored_replicates(folder)
    return QuantityMap(f"{chosen.name}_deviation", replicates.quantity(chosen).deviation, chosen.unit, replicates.grid)
