"""Single Compton scatter of reconstructed volumes.

The physics is that of the simulator (`phantomgen.effects.scatter`): photons are attenuated on their way to a point,
free electrons at rest scatter them once (Klein & Nishina 1929, doi:10.1007/BF01366453), and they are attenuated on
their way to the panel. Here volumes of basis functions attenuate, and the number of electrons follows from the
coefficients. Scatter is smooth: it is computed for some of the views at few places of the panel.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.spectral_model import Spectra
from phantomgen.effects.scatter import in_beam, scatterers
from phantomgen.effects.smooth_signal import SmoothSignal, line_places
from phantomgen.geometry.curved_panel import pixel_areas, ray_directions
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.compton import scattered_to
from phantomgen.ops.compton.inputs import Energies, Points
from recon.ops.segments import segment_integrals
from recon.voxel.iterative.multigrid import occupied, resampled
from spectra.materials.electron_density import ELECTRON_RADIUS, electrons_per_coefficient
from spectra.threads import run_parallel

CELLS = 10  # cells along each edge of the occupied box, each with one point that scatters; see docs/howto/scatter.md
VOXELS = 3  # voxels along each edge of a cell, in which electrons are found and photons attenuated; 6 changes 1 %
PLACES = 7  # places along each edge of the panel; see docs/howto/scatter.md
VIEWS = 36  # views whose scatter is computed at most; between them it is interpolated; see docs/howto/scatter.md
BINS = 12  # energy bins of the incident photons, with equal numbers of photons, as many as the simulator has
STEP = 0.125  # keV; spacing of the tables
LOWEST = 1.0  # keV; basis functions are not evaluated below

Volumes = Float[np.ndarray, "basis z y x"]


@dataclass(frozen=True, eq=False)
class ScatteringVolumes:
    """Volumes that attenuate, and points that scatter.

    Parameters
    ----------
    place : of the points (x, y, z) [mm]
    strength : electrons of each point times r_e^2 / 2 [mm^2]
    volumes : coefficients of all basis functions [1/mm]
    grid : their voxels
    """

    place: Float[np.ndarray, "point 3"]
    strength: Float[np.ndarray, " point"]
    volumes: Volumes
    grid: Grid

    @classmethod
    def of(cls, volumes: Volumes, grid: Grid, electrons: Float[np.ndarray, " basis"]) -> "ScatteringVolumes":
        """Reduce volumes to `CELLS` cells along each axis.

        Parameters
        ----------
        volumes : coefficients [1/mm]
        grid : their voxels
        electrons : per volume and coefficient of each basis function [1/mm^2]

        Returns
        -------
        points and volumes
        """
        box = occupied(volumes)
        inner, count = grid.part(box), CELLS * VOXELS
        spacing = tuple(n * s / count for n, s in zip(inner.shape, inner.spacing, strict=True))
        first = (o - s / 2 + new / 2 for o, s, new in zip(inner.origin, inner.spacing, spacing, strict=True))
        coarse = Grid((count,) * 3, spacing, tuple(first))  # type: ignore[arg-type]
        few = resampled(volumes[:, *box], inner, coarse)
        density = np.maximum(np.tensordot(electrons, few, axes=1), 0.0)
        place, number = scatterers(density, coarse, CELLS, np.random.RandomState(0))
        return cls(place, number * ELECTRON_RADIUS**2 / 2, few, coarse)

    def lengths(
        self, starts: Float[np.ndarray, "ray 3"], end: Float[np.ndarray, " 3"]
    ) -> Float[np.ndarray, "ray basis"]:
        """Line integrals of all basis functions between points and one point."""
        return segment_integrals(starts, np.broadcast_to(end, starts.shape), self.volumes, self.grid)


@dataclass(frozen=True, eq=False)
class Beam:
    """Photons of a scan in a few energy bins, and what happens to them.

    Parameters
    ----------
    photons : of each bin at exposure 1, per solid angle along the central ray [1/sr]
    energies : attenuation by the basis functions, and signal of the channels
    basis : basis functions at the middles of the bins
    profile : attenuation of the parts of the beam's profile there [1/mm]
    """

    photons: Float[np.ndarray, " bin"]
    energies: Energies
    basis: Float[np.ndarray, "basis bin"]
    profile: Float[np.ndarray, "part bin"]

    @classmethod
    def of(cls, spectra: Spectra, steradians: float) -> "Beam":
        """Create the beam of a spectral model.

        Parameters
        ----------
        spectra : of a dataset
        steradians : solid angle of the pixel in the middle of the panel

        Returns
        -------
        the beam
        """
        ends = _bin_ends(spectra)
        photons = np.add.reduceat(spectra.source, ends[:-1])
        edges = spectra.edges[ends]
        middles = (edges[:-1] + edges[1:]) / 2
        table = np.arange(0.0, spectra.edges[-1] + 2 * STEP, STEP)
        known, response = _with_lost_energy(spectra)
        signal = np.concatenate([np.zeros((len(response), 1)), response * np.diff(known)], axis=1)
        measured = np.stack([np.interp(table, known, np.cumsum(row)) for row in signal], axis=1)
        curves = np.ascontiguousarray(spectra.basis.evaluate(np.maximum(table, LOWEST)).T)
        parts = np.zeros((0, len(spectra.energy))) if spectra.profile is None else spectra.profile.attenuation
        profile = (
            np.stack([np.interp(middles, spectra.energy, row) for row in parts])
            if len(parts)
            else np.zeros((0, len(middles)))
        )
        return cls(
            photons / steradians, Energies(edges, STEP, curves, measured), spectra.basis.evaluate(middles), profile
        )

    def behind(
        self, lengths: Float[np.ndarray, "ray basis"], parts: Float[np.ndarray, "ray part"]
    ) -> Float[np.ndarray, "ray bin"]:
        """Photons behind line integrals of basis functions and path lengths in the profile [1/sr]."""
        return self.photons * np.exp(-lengths @ self.basis - parts @ self.profile)


def compton_signal(dataset: Dataset, volumes: Volumes, grid: Grid) -> SmoothSignal:
    """Compute the single Compton scatter of volumes in every view of a dataset.

    Parameters
    ----------
    dataset : open dataset; counts are not read
    volumes : coefficients of its basis functions, or of the first ones [1/mm]
    grid : their voxels

    Returns
    -------
    expected scattered signal at exposure 1 and gain 1, in units of the counts

    Raises
    ------
    InputError
        When a basis function does not tell the number of electrons.
    """
    spectra, geometry = dataset.spectra, dataset.geometry
    missing = len(spectra.basis.functions) - len(volumes)
    volumes = np.concatenate([volumes, np.zeros((missing, *volumes.shape[1:]), volumes.dtype)])
    scattering = ScatteringVolumes.of(volumes, grid, electrons_per_coefficient(spectra.basis))
    profile = None if spectra.profile is None else spectra.profile.lengths
    beam = Beam.of(spectra, _middle_solid_angle(geometry))
    some = np.unique(np.linspace(0, len(geometry) - 1, min(VIEWS, len(geometry))).round().astype(int))
    tasks = run_parallel(lambda view: _at_places(geometry, int(view), scattering, beam, profile), some)
    return SmoothSignal(_between_views(geometry.source, some, np.stack(list(tasks))))


def _at_places(
    geometry: Geometry,
    view: int,
    scattering: ScatteringVolumes,
    beam: Beam,
    profile: Float[np.ndarray, "part row column"] | None,
) -> Float[np.ndarray, "channel place_row place_column"]:
    """Scattered signal of a view at places of the panel."""
    panel, source, one = geometry.panel, geometry.source[view], geometry[[view]]
    lit, (row, column) = in_beam(geometry, view, scattering.place)
    place, strength = scattering.place[lit], scattering.strength[lit]
    parts = np.zeros((len(place), 0)) if profile is None else profile[:, row, column].T
    points = Points(place, strength, beam.behind(scattering.lengths(place, source), parts))
    rows, columns = line_places(panel.rows, PLACES), line_places(panel.columns, PLACES)
    targets, areas = source + ray_directions(one, columns, rows)[0], pixel_areas(one, columns)[0]
    found = np.zeros((beam.energies.measured.shape[1], PLACES, PLACES))
    for i, j in np.ndindex(PLACES, PLACES):
        lengths = scattering.lengths(place, targets[i, j])
        found[:, i, j] = scattered_to(targets[i, j], areas[j], source, points, lengths, beam.energies)
    return found


def _between_views(
    source: Float[np.ndarray, "view 3"], some: np.ndarray, found: Float[np.ndarray, "few channel r c"]
) -> Float[np.ndarray, "view channel r c"]:
    """Signals of all views, from the two computed views whose sources are nearest, by distance."""
    if len(some) == 1:
        return np.repeat(found, len(source), axis=0)
    apart = np.linalg.norm(source[:, None] - source[some], axis=2)
    near = np.argsort(apart, axis=1, kind="stable")[:, :2]
    first, second = np.take_along_axis(apart, near, axis=1).T
    share = np.divide(first, first + second, out=np.zeros_like(first), where=first + second > 0)[:, None, None, None]
    return (1 - share) * found[near[:, 0]] + share * found[near[:, 1]]


def _middle_solid_angle(geometry: Geometry) -> float:
    """Solid angle of the pixel in the middle of the panel in the first view [sr]."""
    center = geometry.panel_center[0] - geometry.source[0]
    area = np.cross(geometry.column_step[0], geometry.row_step[0])
    return float(abs(center @ area) / np.linalg.norm(center) ** 3)


def _with_lost_energy(
    spectra: Spectra,
) -> tuple[Float[np.ndarray, " energy_plus_1"], Float[np.ndarray, "channel energy"]]:
    """Edges and responses of energies, also below the spectrum where a detector sums up energies.

    The file states the response to photons of the source. Scattered ones have lost energy, and those below the spectrum
    are taken to be absorbed as those at its lower end are.
    """
    edges, response = spectra.edges, spectra.response
    if spectra.units == "counts" or edges[0] <= LOWEST + STEP:
        return edges, response
    below = np.append(np.arange(LOWEST, edges[0], STEP), edges[0])
    below = below[np.append(np.diff(below) > 1e-9, True)]
    part = (below[:-1] + below[1:]) / 2 / spectra.energy[0]
    return np.append(below[:-1], edges), np.concatenate([response[:, :1] * part, response], axis=1)


def _bin_ends(spectra: Spectra) -> np.ndarray:
    """Ends of `BINS` bins with about equal numbers of photons that a channel sees, as numbers of energy edges."""
    seen = np.flatnonzero(spectra.source * spectra.response.sum(axis=0) > 0)
    first, last = seen[0], seen[-1] + 1
    below = np.concatenate([[0.0], np.cumsum(spectra.source[first:last])])
    wanted = np.searchsorted(below, np.linspace(0, below[-1], BINS + 1)[1:-1])
    return np.unique(np.concatenate([[first], first + wanted, [last]]))
