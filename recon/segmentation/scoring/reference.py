"""Truth of a dataset, described as a segmentation is, to score one against."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.layout import FRACTION_SCALE
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.truth import Truth, read_truth
from phantomgen.geometry.poses import Geometry
from recon.readouts.readouts import Readouts
from recon.segmentation.features import features_of
from recon.segmentation.labelling import NOTHING, ordered
from recon.segmentation.rendering import slices_rgb, views_around
from recon.segmentation.result import Cluster, Segmentation, describe
from spectra.errors import InputError

VIEWS = 10  # views in which images are compared; our choice


@dataclass(frozen=True, eq=False)
class Reference:
    """Truth of a dataset, described as a segmentation is.

    Parameters
    ----------
    truth : material fractions and coefficients of the dataset
    readouts : conversion of coefficients to physical numbers, for all basis functions of the dataset
    materials : materials as clusters, in the order of the truth
    geometry : views in which images are compared
    """

    truth: Truth
    readouts: Readouts
    materials: tuple[Cluster, ...]
    geometry: Geometry

    @property
    def densities(self) -> Float[np.ndarray, " material"]:
        """Density rho of each material [1/mm]."""
        return np.array([m.features[0] for m in self.materials])

    @property
    def colours(self) -> Float[np.ndarray, "material 3"]:
        """RGB of each material, 0 to 1."""
        return np.array([m.colour for m in self.materials])

    @property
    def volumes(self) -> Float[np.ndarray, "material z y x"]:
        """Density of each material in each voxel [1/mm]."""
        scale = (self.densities / FRACTION_SCALE).astype(np.float32)
        return self.truth.fractions * scale[:, None, None, None]

    def rgb(self) -> Float[np.ndarray, "z y x 3"]:
        """Compute RGB of all voxels.

        Returns
        -------
        RGB, 0 to 1
        """
        return slices_rgb(self.volumes, self.densities, self.colours, self.truth.labels > NOTHING)


def read_reference(path: Path, segmentation: Segmentation) -> Reference | None:
    """Read the truth of a dataset.

    Parameters
    ----------
    path : dataset
    segmentation : material maps that will be scored

    Returns
    -------
    truth; None where the dataset has none

    Raises
    ------
    InputError
        When the truth is on another grid than the run, or in other basis functions.
    DatasetError
        When the file is no dataset.
    """
    truth, subject = read_truth(path), segmentation.subject
    if truth is None:
        return None
    if truth.grid != subject.grid:
        raise InputError(f"the truth of {path} has another grid than the run: scores need the dataset it was fitted to")
    with open_dataset(path, air=(slice(0, 1), slice(0, 1))) as dataset:
        basis, tests, geometry = dataset.spectra.basis, dataset.splits["test"], dataset.geometry
    if not set(truth.basis_names) <= set(basis.names):
        raise InputError(f"the truth of {path} is in {', '.join(truth.basis_names)}, its spectra in other functions")
    readouts = Readouts.of(basis, subject.energy, subject.weights)
    volumes = truth.fractions.sum(axis=(1, 2, 3)) / FRACTION_SCALE * truth.grid.voxel_volume / 1000
    coefficients = truth.coefficients[:, [truth.basis_names.index(n) for n in basis.names]]
    order = ordered(features_of(readouts.mechanisms, readouts.mechanisms(coefficients.T)).T)
    found = describe(readouts, coefficients[order], segmentation.options.energies, volumes[order])
    materials = tuple(found[i] for i in np.argsort(order))
    picked = tests[(np.arange(min(VIEWS, len(tests))) * len(tests)) // VIEWS] if len(tests) else None
    around = views_around(truth.grid, [(360.0 * i / VIEWS, 0.0) for i in range(VIEWS)])
    return Reference(truth, readouts, materials, around if picked is None else geometry[picked])
