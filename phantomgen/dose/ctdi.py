"""CTDI: air kerma in cylinders of PMMA, as quality assurance measures it with a pencil chamber."""

from dataclasses import dataclass
from math import pi

import numpy as np

from phantomgen.dose.beam import ScanBeam
from phantomgen.dose.run import BATCHES, JOULE, follow_scan
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.photon_transport.inputs import Probes
from phantomgen.ops.voxelize_shapes import fractions
from phantomgen.scene.scan import Scan
from phantomgen.shapes import Cylinder, solids_of
from spectra.errors import InputError
from spectra.materials.material import Material

HEAD, BODY = 160.0, 320.0  # mm; diameters (IEC 60601-2-44)
_PMMA = Material("PMMA", density=1.19, composition="C5H8O2")
_LENGTH, _CHAMBER, _RADIUS, _DEPTH = 150.0, 100.0, 5.0, 10.0  # of cylinder and chamber; from the surface [mm]
_ACROSS, _ALONG = 96, 30  # voxels
_ORBITS = ("circular", "helical", "parallel")
_GRAM = 1e-3  # kg


@dataclass(frozen=True)
class Ctdi:
    """CTDI in one cylinder, for all views of a scan; of a helix, for one turn.

    Parameters
    ----------
    diameter : of the cylinder [mm]
    width : of the beam at the isocentre, along z [mm]
    pitch : travel of a helix in a turn over `width`; 1 without travel
    centre, periphery : CTDI100 in the middle and 10 mm below the surface, the mean of four places [Gy]
    error : standard error of `weighted`, relative
    """

    diameter: float
    width: float
    pitch: float
    centre: float
    periphery: float
    error: float

    @property
    def weighted(self) -> float:
        """CTDIw, a third of the centre and two thirds of the periphery [Gy] (IEC 60601-2-44)."""
        return self.centre / 3 + 2 * self.periphery / 3

    @property
    def volume(self) -> float:
        """CTDIvol [Gy]."""
        return self.weighted / self.pitch

    def to_dict(self) -> dict[str, float]:
        """Convert to plain values.

        Returns
        -------
        all values, doses in Gy
        """
        return {
            "diameter_mm": self.diameter,
            "beam_width_mm": self.width,
            "pitch": self.pitch,
            "centre_Gy": self.centre,
            "periphery_Gy": self.periphery,
            "weighted_Gy": self.weighted,
            "volume_Gy": self.volume,
            "relative_error": self.error,
        }


def ctdi_of(scan: Scan, diameter: float, photons: int, seed: int, title: str | None = None) -> Ctdi:
    """Compute CTDI for the beam of a scan, with a cylinder in place of its objects.

    Parameters
    ----------
    scan : the scan
    diameter : of the cylinder [mm]
    photons : that are followed
    seed : of their random numbers
    title : of a progress bar; None for none

    Returns
    -------
    CTDI

    Raises
    ------
    InputError
        When the source does not turn around the z axis.

    Notes
    -----
    Air kerma in the chamber's place is computed in PMMA, without the hole, from the fluence of photons there.
    """
    if scan.geometry.kind not in _ORBITS:
        raise InputError(f"CTDI is defined for {', '.join(_ORBITS)} orbits around z, not for {scan.geometry.kind} ones")
    turn, travel = one_turn(scan.geometry)
    beam, width = ScanBeam.of(scan).at_height_zero(len(turn)), beam_width(scan.geometry)
    grid = _grid(diameter)
    cylinder = solids_of([(Cylinder((0, 0, 0), diameter / 2, _LENGTH), 0)])
    probes = _chambers(diameter)
    found = follow_scan(beam, (_PMMA,), fractions(grid, cylinder, 1), grid, photons, seed, probes, title)
    volume = pi * _RADIUS**2 * _CHAMBER
    kerma = found.air / volume * JOULE / _GRAM * _CHAMBER / width
    centre, periphery = kerma[:, 0], kerma[:, 1:].mean(axis=1)
    weighted = centre / 3 + 2 * periphery / 3
    error = weighted.std(ddof=1) / np.sqrt(BATCHES) / weighted.mean()
    pitch = 1.0 if travel == 0 else travel / width
    return Ctdi(diameter, width, pitch, float(centre.mean()), float(periphery.mean()), float(error))


def beam_width(geometry: Geometry) -> float:
    """Compute the width of the beam along z at the isocentre.

    Parameters
    ----------
    geometry : of the scan

    Returns
    -------
    height of the panel, by the ratio of distances [mm]
    """
    height = geometry.panel.rows * geometry.panel.row_pitch
    if geometry.is_parallel:
        return float(height)
    to_axis = np.linalg.norm(geometry.source[0, :2])
    return float(height * to_axis / np.linalg.norm((geometry.panel_center - geometry.source)[0, :2]))


def one_turn(geometry: Geometry) -> tuple[Geometry, float]:
    """Return the views of the first turn of a helix, and the travel of a turn; all views of another orbit, and 0.

    Parameters
    ----------
    geometry : of the scan

    Returns
    -------
    views, and travel [mm]

    Raises
    ------
    InputError
        When a helix has less than one turn.
    """
    if geometry.kind != "helical":
        return geometry, 0.0
    angle = np.unwrap(np.arctan2(geometry.source[:, 1], geometry.source[:, 0]))
    angle = np.abs(angle - angle[0])
    count = int(np.searchsorted(angle, 2 * pi - 1e-6))
    if count >= len(geometry):
        raise InputError("CTDI of a helix needs the views of one turn at least")
    slope = (geometry.source[count, 2] - geometry.source[0, 2]) / angle[count] * 2 * pi
    return geometry[np.arange(count)], abs(float(slope))


def _grid(diameter: float) -> Grid:
    across, along = diameter / _ACROSS, _LENGTH / _ALONG
    first = -(diameter - across) / 2
    return Grid((_ALONG, _ACROSS, _ACROSS), (along, across, across), (-(_LENGTH - along) / 2, first, first))


def _chambers(diameter: float) -> Probes:
    """The pencil chamber in the middle, and at four places below the surface."""
    away = diameter / 2 - _DEPTH
    centre = np.array([[0, 0], [away, 0], [0, away], [-away, 0], [0, -away]], dtype=np.float64)
    return Probes(centre, np.full(5, _RADIUS), np.tile([-_CHAMBER / 2, _CHAMBER / 2], (5, 1)))
