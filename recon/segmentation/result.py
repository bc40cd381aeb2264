"""Results of a segmentation: its options, the clusters with their physical numbers, and the maps."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, Integer

from recon.readouts.readouts import Readouts, check_energies
from recon.segmentation.clustering import BANDWIDTH
from recon.segmentation.colours import colours_of, kind_of, names_of
from recon.segmentation.features import features_of
from recon.segmentation.labelling import NOTHING
from recon.segmentation.rendering import slices_rgb
from recon.segmentation.subject import Subject
from spectra.errors import InputError

DOMAINS = ("gaussians", "voxels")
FEATURES = ("local", "own")
ENERGY = 70.0  # keV; energy of virtual monoenergetic images by default; reference energy of the bases


@dataclass(frozen=True)
class Options:
    """Options of a segmentation.

    Parameters
    ----------
    domain : ``gaussians`` or ``voxels``; None for Gaussians where a run has them
    features : features of the values at each Gaussian (``local``), or of its own coefficients (``own``), as in the
        paper
    bandwidth : bandwidth of the mean shift, in units of `recon.segmentation.clustering.unit_of`
    energies : energies of virtual monoenergetic images [keV]
    seed : seed of the choice of samples
    """

    domain: str | None = None
    features: str = FEATURES[0]
    bandwidth: float = BANDWIDTH
    energies: tuple[float, ...] = (ENERGY,)
    seed: int = 0

    def __post_init__(self) -> None:
        if self.domain not in (None, *DOMAINS):
            raise InputError(f"the domain must be one of {', '.join(DOMAINS)}, got {self.domain!r}")
        if self.features not in FEATURES:
            raise InputError(f"the features must be one of {', '.join(FEATURES)}, got {self.features!r}")
        if not 0 < self.bandwidth < np.inf:
            raise InputError(f"the bandwidth must be positive, got {self.bandwidth}")
        object.__setattr__(self, "energies", check_energies(self.energies))


@dataclass(frozen=True, eq=False)
class Cluster:
    """One material that was found.

    Parameters
    ----------
    name : name of the kind of material, such as ``soft tissue 1``
    colour : RGB, 0 to 1
    coefficients : medians inside of the material, of each basis function [1/mm]
    features : rho [1/mm], kappa, f_K of each K edge
    volume_ml : volume of its voxels [ml]
    atomic_number, electron_density : values without contrast agents; the density relative to water; NaN where unknown
    hounsfield : CT number at each energy of the options [HU]
    without_contrast : CT number at each energy without contrast agents [HU]
    concentrations : concentration of each contrast agent [mg/ml]
    """

    name: str
    colour: Float[np.ndarray, "3"]
    coefficients: Float[np.ndarray, " basis"]
    features: Float[np.ndarray, " feature"]
    volume_ml: float
    atomic_number: float
    electron_density: float
    hounsfield: tuple[float, ...]
    without_contrast: tuple[float, ...]
    concentrations: dict[str, float]


@dataclass(frozen=True, eq=False)
class Segmentation:
    """Material maps of a run.

    Parameters
    ----------
    subject : volumes that were segmented
    readouts : conversion of coefficients to physical numbers
    options : options, with the `domain` that was used
    clusters : clusters without K edge by kappa and density, then those of each K edge by its part
    labels : labels of voxels: 0 air, i + 1 cluster i
    materials : density of each cluster [1/mm]
    gaussian_labels : cluster of each Gaussian; None in the domain of voxels
    gaussian_densities : density of each cluster at the centre of each Gaussian [1/mm]; None in the domain of voxels
    """

    subject: Subject
    readouts: Readouts
    options: Options
    clusters: tuple[Cluster, ...]
    labels: Integer[np.ndarray, "z y x"]
    materials: Float[np.ndarray, "material z y x"]
    gaussian_labels: Int[np.ndarray, " gaussian"] | None = None
    gaussian_densities: Float[np.ndarray, "gaussian material"] | None = None

    @property
    def colours(self) -> Float[np.ndarray, "material 3"]:
        """RGB of each cluster, 0 to 1."""
        return np.array([c.colour for c in self.clusters])

    @property
    def densities(self) -> Float[np.ndarray, " material"]:
        """Density rho of each cluster [1/mm]."""
        return np.array([c.features[0] for c in self.clusters])

    def rgb(self, colours: Float[np.ndarray, "material 3"] | None = None) -> Float[np.ndarray, "z y x 3"]:
        """Compute RGB of all voxels.

        Parameters
        ----------
        colours : RGB of each cluster, 0 to 1; those of the clusters where it is None

        Returns
        -------
        RGB, 0 to 1
        """
        chosen = self.colours if colours is None else colours
        return slices_rgb(self.materials, self.densities, chosen, self.labels > NOTHING)


def describe(
    readouts: Readouts,
    coefficients: Float[np.ndarray, "cluster basis"],
    energies: Sequence[float],
    volumes_ml: Float[np.ndarray, " cluster"],
) -> tuple[Cluster, ...]:
    """Compute names, colours and physical numbers of materials from their coefficients.

    Parameters
    ----------
    readouts : conversion of coefficients to physical numbers
    coefficients : coefficients of the materials, in the order of `recon.segmentation.labelling.ordered` [1/mm]
    energies : energies of virtual monoenergetic images [keV]
    volumes_ml : volumes of the materials [ml]

    Returns
    -------
    clusters in the same order
    """
    columns = np.asarray(coefficients, dtype=np.float64).T
    features = features_of(readouts.mechanisms, readouts.mechanisms(columns)).T
    plain = readouts.without_contrast(columns)
    numbers, electrons = readouts.electrons(columns)
    kinds = [
        kind_of(row, float(number), tuple(readouts.basis.names[i] for i in readouts.mechanisms.edges))
        for row, number in zip(features, numbers, strict=True)
    ]
    monoenergetic = np.array([readouts.hounsfield(columns, e) for e in energies]).reshape(len(energies), -1)
    virtual = np.array([readouts.hounsfield(plain, e) for e in energies]).reshape(len(energies), -1)
    agents = {element: readouts.concentration(columns, element) for element in readouts.agents}
    return tuple(
        Cluster(
            name, colour, columns[:, i], features[i], float(volumes_ml[i]), float(numbers[i]), float(electrons[i]),
            tuple(map(float, monoenergetic[:, i])), tuple(map(float, virtual[:, i])),
            {element: float(amount[i]) for element, amount in agents.items()},
        )
        for i, (name, colour) in enumerate(zip(names_of(kinds), colours_of(kinds), strict=True))
    )  # fmt: skip
