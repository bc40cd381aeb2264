"""Standard deviations of a run in a few numbers: of its bases, and of the quantities that they show."""

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from recon.data.volume_edges import occupied_voxels
from recon.readouts.quantity import Quantity, in_pieces, quantity
from recon.readouts.readouts import Readouts
from recon.readouts.spectrum import detected_spectrum
from recon.runs.read_run import StoredModel, open_model, read_run
from recon.uncertainty.estimate import Uncertainty


class Row(NamedTuple):
    """Standard deviation of one volume over the voxels that are not air.

    Parameters
    ----------
    name, unit : of the volume
    median, high : median and 95th percentile of the standard deviation of a voxel
    largest : largest value of the volume; its 99.9th percentile
    """

    name: str
    unit: str
    median: float
    high: float
    largest: float


@dataclass(frozen=True)
class Summary:
    """Standard deviations of all volumes of a run.

    Parameters
    ----------
    rows : of each basis, of CT numbers at 70 keV, and of each concentration
    """

    rows: tuple[Row, ...]


def summary(folder: Path, uncertainty: Uncertainty) -> Summary:
    """Summarise the standard deviations of a run.

    Parameters
    ----------
    folder : run folder
    uncertainty : of its basis volumes

    Returns
    -------
    rows of bases, CT numbers and concentrations
    """
    volumes, spread = read_run(folder).volumes, uncertainty.spread
    occupied = occupied_voxels(volumes)
    names = uncertainty.replicates.basis_names
    rows = [
        _row(name, "1/mm", value, deviation, occupied)
        for name, value, deviation in zip(names, volumes, spread.deviation, strict=True)
    ]
    for shown in main_quantities(open_model(folder)):
        found = uncertainty.replicates.quantity(shown)
        rows.append(_row(shown.about, shown.unit, in_pieces(shown, volumes), found.deviation, occupied))
    return Summary(tuple(rows))


def main_quantities(stored: StoredModel) -> list[Quantity]:
    """Return the quantities of which standard deviations are told.

    Parameters
    ----------
    stored : result of a run

    Returns
    -------
    CT numbers at 70 keV, and the concentration of each contrast agent
    """
    readouts = Readouts.of(stored.basis, *detected_spectrum(stored.basis, stored.transmission))
    return [quantity(readouts, name) for name in ("hu", *readouts.agents)]


def _row(
    name: str,
    unit: str,
    values: Float[np.ndarray, "z y x"],
    deviation: Float[np.ndarray, "z y x"],
    occupied: Bool[np.ndarray, "z y x"],
) -> Row:
    """Numbers of one volume."""
    inside = deviation[occupied]
    inside = inside[np.isfinite(inside)]
    if not inside.size:
        return Row(name, unit, 0.0, 0.0, 0.0)
    largest = float(np.quantile(values[occupied], 0.999))
    return Row(name, unit, float(np.median(inside)), float(np.quantile(inside, 0.95)), largest)
