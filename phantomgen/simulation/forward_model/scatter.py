"""Scattered signal of the views of a scan, by the model that the scan requires."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from phantomgen.effects import ScatterKernel
from phantomgen.effects.random_streams import Stream, generator
from phantomgen.effects.scatter import in_beam, scatterers
from phantomgen.effects.smooth_signal import line_places, spline_weights
from phantomgen.geometry.curved_panel import pixel_areas, ray_directions
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.compton import scattered_to
from phantomgen.ops.compton.inputs import Energies, Points
from phantomgen.scene.scan import Scan
from phantomgen.simulation.forward_model.discretization import Settings
from phantomgen.simulation.forward_model.exposure import Exposure, Groups
from spectra.detector.detector import AnyDetector
from spectra.detector.multi_source import MultiSource
from spectra.energy import grid as grids
from spectra.materials.electron_density import ELECTRON_RADIUS, electron_density
from spectra.source.source import Source

# From a view and its primary signal to what is scattered in it.
Scatter = Callable[[int, Groups], Groups]
# Of Compton scatter: energy bins per source, and spacing of tables [keV].
_BINS = 12
_STEP = 0.125
# Voxels along each edge of a cell, in which its electrons are found.
_VOXELS = 4


def scatter_of(scan: Scan, exposure: Exposure, settings: Settings, first: Groups, air: Groups) -> Scatter:
    """Create the function that computes the scatter of any view.

    Parameters
    ----------
    scan, exposure, settings : what is simulated, and how finely
    first, air : primary signal of the first view, and of one without objects

    Returns
    -------
    function of a view and its primary signal that returns the scattered signal
    """
    model, panel, grid = scan.effects.scatter, scan.geometry.panel, scan.effects.grid
    if isinstance(model, ScatterKernel):
        strength = model.strength(first, air, panel) * (1.0 if grid is None else grid.scatter / grid.primary)
        return lambda _, primary: strength * model.spread(primary, air, panel)
    passing = 1.0 if grid is None else grid.scatter
    if scan.dynamics is not None:
        return lambda view, _: passing * SingleScatter.of(scan.instant(view), exposure, settings).view(view)
    single = SingleScatter.of(scan, exposure, settings)
    return lambda view, _: passing * single.view(view)


@dataclass(frozen=True, eq=False)
class Beam:
    """Photons of one source.

    Parameters
    ----------
    photons : of each bin, per solid angle along the central ray [1/sr]
    energies : what happens to them
    """

    photons: Float[np.ndarray, " bin"]
    energies: Energies

    def weakened(
        self, lengths: Float[np.ndarray, "ray material"], profile: Float[np.ndarray, "ray bin"] | float
    ) -> Float[np.ndarray, "ray bin"]:
        """Compute the photons behind path lengths in materials and behind the profile of the beam.

        Parameters
        ----------
        lengths : path lengths [mm], (ray, material)
        profile : exponent of the beam's profile, (ray, bin)

        Returns
        -------
        photons per solid angle [1/sr], (ray, bin)
        """
        return self.photons * np.exp(-np.einsum("rm,bm->rb", lengths, self._attenuation()) - profile)

    @property
    def middles(self) -> Float[np.ndarray, " bin"]:
        """Middles of the bins [keV]."""
        return (self.energies.edges[:-1] + self.energies.edges[1:]) / 2

    def _attenuation(self) -> Float[np.ndarray, "bin material"]:
        """Attenuation of the materials at the middles [1/mm]."""
        return self.energies.attenuation[np.rint(self.middles / self.energies.step).astype(np.int64)]


@dataclass(frozen=True, eq=False)
class SingleScatter:
    """Single Compton scatter of a scan.

    Parameters
    ----------
    scan : what is scanned
    beams : energies of each source
    place, strength : points that scatter [mm], and their electrons times r_e^2 / 2 [mm^2]
    places : along each edge of the panel, where scatter is computed
    """

    scan: Scan
    beams: tuple[Beam, ...]
    place: Float[np.ndarray, "point 3"]
    strength: Float[np.ndarray, " point"]
    places: int

    @classmethod
    def of(cls, scan: Scan, exposure: Exposure, settings: Settings) -> "SingleScatter":
        """Create the model with cells and places as `settings` say.

        Parameters
        ----------
        scan : what is simulated
        exposure : energies
        settings : how finely it is computed

        Returns
        -------
        the model
        """
        place, electrons = _electrons(scan, settings.scatter[0])
        return cls(scan, _beams(scan, exposure), place, electrons * ELECTRON_RADIUS**2 / 2, settings.scatter[1])

    def view(self, view: int) -> Groups:
        """Compute the scattered signal of each group in a view.

        Parameters
        ----------
        view : number of the view

        Returns
        -------
        signals, (group, row, column)
        """
        scan, panel = self.scan, self.scan.geometry.panel
        geometry, source = scan.geometry[[view]], scan.geometry.source[view]
        rows, columns = line_places(panel.rows, self.places), line_places(panel.columns, self.places)
        pixels, areas = source + ray_directions(geometry, columns, rows)[0], pixel_areas(geometry, columns)[0]
        if scan.effects.aperture is not None:
            areas = areas * scan.effects.aperture.area
        points = self._points(view)
        found = np.zeros((self.beams[0].energies.measured.shape[1], len(rows), len(columns)))
        for i, j in np.ndindex(*found.shape[1:]):
            lengths = self._lengths(points[0].place, pixels[i, j] - points[0].place)
            for beam, lit in zip(self.beams, points, strict=True):
                found[:, i, j] += scattered_to(pixels[i, j], areas[j], source, lit, lengths, beam.energies)
        down, across = spline_weights(panel.rows, self.places), spline_weights(panel.columns, self.places)
        return np.maximum(np.einsum("ri,gic->grc", down, np.einsum("gij,cj->gic", found, across)), 0.0)

    def _points(self, view: int) -> list[Points]:
        """Points in the beam of a view, with the photons of each source that come there."""
        geometry, profile = self.scan.geometry, self.scan.profile
        lit, (row, column) = in_beam(geometry, view, self.place)
        place, strength, source = self.place[lit], self.strength[lit], geometry.source[view]
        lengths = self._lengths(np.broadcast_to(source, place.shape), place - source)
        thickness = np.zeros((len(place), 0)) if profile is None else profile.lengths[:, row, column].T
        points = []
        for beam in self.beams:
            before = 0.0 if profile is None else thickness @ profile.attenuation(beam.middles)
            points.append(Points(place, strength, beam.weakened(lengths, before)))
        return points

    def _lengths(
        self, origins: Float[np.ndarray, "ray 3"], directions: Float[np.ndarray, "ray 3"]
    ) -> Float[np.ndarray, "ray material"]:
        """Path lengths in the materials [mm]."""
        return self.scan.scene.path_lengths(origins, directions)


def _electrons(scan: Scan, cells: int) -> tuple[Float[np.ndarray, "point 3"], Float[np.ndarray, " point"]]:
    """Points that stand for the cells of the volume [mm], and how many electrons there are."""
    scene, size = scan.scene, np.array(scan.grid.shape) * scan.grid.spacing
    count = cells * _VOXELS
    spacing = size / count
    first = np.array(scan.grid.origin) - np.array(scan.grid.spacing) / 2 + spacing / 2
    grid = Grid((count, count, count), tuple(spacing.tolist()), tuple(first.tolist()))
    filled = scene.fractions(grid)
    densities = [electron_density(m, scan.basis) for m in scene.materials]
    rng = generator(0, Stream.SCATTER, 0, 0)
    return scatterers(np.tensordot(densities, filled, axes=1), grid, cells, rng)


def _beams(scan: Scan, exposure: Exposure) -> tuple[Beam, ...]:
    """Energies of each source of a scan, with the groups of its own channels."""
    detector = scan.detector
    several = isinstance(detector, MultiSource)
    pairs = list(zip(detector.sources, detector.detectors, strict=True)) if several else [(scan.source, detector)]
    beams, channel = [], 0
    for source, own in pairs:
        beams.append(_beam(scan, exposure, source, own, channel))
        channel += len(own)
    return tuple(beams)


def _beam(scan: Scan, exposure: Exposure, source: Source, detector: AnyDetector, first: int) -> Beam:
    """Energies of one source, whose channels are those from `first` on."""
    energies, photons = source.sampled(source.grid(detector.lowest, _BINS, detector.breaks))
    table = np.arange(0.0, max(source.maximum, energies.edges[-1]) + 2 * _STEP, _STEP)
    bins = grids.Energies.from_edges(table[table >= 1.0])
    channels = exposure.channels - first
    if scan.pulses is not None:  # one source, and a channel for each group
        detector, channels = scan.pulses, np.arange(len(exposure.channels))
    response = np.where(bins.nodes >= detector.lowest_scattered, detector.response(bins), 0.0)
    measured = np.zeros((len(exposure.channels), len(table)))
    for group, channel in enumerate(channels):
        if 0 <= channel < len(response):
            signal = response[channel]
            if exposure.quanta is not None:
                signal = np.where(_nearest(exposure, int(first + channel), bins.nodes) == group, signal, 0.0)
            measured[group, -len(bins) :] = np.cumsum(signal * bins.widths)
    curves = np.stack([m.attenuation(np.maximum(table, 1.0), scan.basis) for m in scan.scene.materials])
    geometry = scan.geometry
    center = geometry.panel_center[0] - geometry.source[0]
    distance = np.linalg.norm(center)
    steradians = abs(center @ np.cross(geometry.column_step[0], geometry.row_step[0])) / distance**3
    tables = (np.ascontiguousarray(values.T) for values in (curves, measured))
    return Beam(photons / steradians, Energies(energies.edges, _STEP, *tables))


def _nearest(exposure: Exposure, channel: int, energy: Float[np.ndarray, " energy"]) -> np.ndarray:
    """Group of a channel, whose photons come closest to some energies."""
    groups = np.flatnonzero(exposure.channels == channel)
    quanta = np.asarray(exposure.quanta)[groups]
    return groups[np.abs(energy[:, None] - quanta).argmin(axis=1)]
