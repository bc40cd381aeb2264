"""Photons of a scan followed in batches, whose spread tells the statistical error."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from tqdm.auto import tqdm

from phantomgen.dose.beam import ScanBeam
from phantomgen.dose.crossings import crossings_of
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.photon_transport import transport
from phantomgen.ops.photon_transport.inputs import Deposits, Medium, Probes
from spectra.materials.material import Material
from spectra.threads import run_parallel

BATCHES = 20
NO_PROBES = Probes(np.zeros((0, 2)), np.zeros(0), np.zeros((0, 2)))
JOULE = 1.602176634e-16  # in a keV (CODATA 2018)
_KILOGRAM_MM3 = 1e-6  # density of 1 g/cm^3 [kg/mm^3]


@dataclass(frozen=True, eq=False)
class Batches:
    """What photons of a scan leave, batch by batch; each stands for all photons of the scan.

    Parameters
    ----------
    voxels : mean over the batches of the energy in each voxel [keV]
    voxel_errors : standard errors of `voxels`
    energy : in each probe [keV]
    air : air kerma x volume of each probe [keV mm^3/g]
    absorbed : part of the energy of all photons that stays in the voxels
    """

    voxels: Float[np.ndarray, "z y x"]
    voxel_errors: Float[np.ndarray, "z y x"]
    energy: Float[np.ndarray, "batch probe"]
    air: Float[np.ndarray, "batch probe"]
    absorbed: float


def follow_scan(
    beam: ScanBeam,
    materials: tuple[Material, ...],
    fractions: Float[np.ndarray, "material z y x"],
    grid: Grid,
    photons: int,
    seed: int,
    probes: Probes = NO_PROBES,
    title: str | None = None,
) -> Batches:
    """Follow some photons of a scan, and scale what they leave to all of its photons.

    Parameters
    ----------
    beam : of the scan
    materials : with compositions
    fractions : part of each voxel that each material fills
    grid : the voxels
    photons : that are followed
    seed : of their random numbers
    probes : cylinders in which energy and air kerma are summed
    title : of a progress bar; None for none

    Returns
    -------
    energies, by batch
    """
    spacing = np.array(grid.spacing)
    medium = Medium(np.ascontiguousarray(fractions, dtype=np.float64), np.array(grid.origin) - spacing / 2, spacing)
    crossings, drawn = crossings_of(materials, float(beam.drawn.energy.max())), beam.drawn
    count = -(-photons // BATCHES)
    seeds = np.random.SeedSequence(seed).generate_state(BATCHES)

    def batch(number: int) -> Deposits:
        return transport(count, int(seeds[number]), drawn, medium, crossings, probes)

    scale = beam.photons / count
    total, square, energy, air, ends = np.zeros(grid.shape), np.zeros(grid.shape), [], [], np.zeros(3)
    for found in _shown(run_parallel(batch, range(BATCHES)), title):
        total += found.voxels * scale
        square += (found.voxels * scale) ** 2
        energy.append(found.energy * scale)
        air.append(found.air * scale)
        ends += found.ends
    mean = total / BATCHES
    errors = np.sqrt(np.maximum(square / BATCHES - mean**2, 0) / (BATCHES - 1))
    return Batches(mean, errors, np.stack(energy), np.stack(air), float(ends[2] / ends[0]))


def masses(
    materials: tuple[Material, ...], fractions: Float[np.ndarray, "material z y x"], grid: Grid
) -> Float[np.ndarray, "z y x"]:
    """Compute the mass in each voxel.

    Parameters
    ----------
    materials : with densities
    fractions : part of each voxel that each material fills
    grid : the voxels

    Returns
    -------
    masses [kg]
    """
    densities = np.array([material.density for material in materials], dtype=np.float64)
    return np.tensordot(densities, fractions, axes=1) * float(np.prod(grid.spacing)) * _KILOGRAM_MM3


def _shown(batches: Iterator[Deposits], title: str | None) -> Iterator[Deposits]:
    """Show a bar on stderr."""
    yield from tqdm(batches, total=BATCHES, desc=title, unit="batch", disable=None if title else True)
