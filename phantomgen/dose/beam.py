"""The beam of a scan: how many photons leave the source in each view, of which energy, and where they go."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.curved_panel import module_frames
from phantomgen.ops.photon_transport.inputs import Beam
from phantomgen.scene.scan import Scan
from phantomgen.simulation.forward_model.energy_grids import fine_transmission
from phantomgen.simulation.forward_model.tube_output import attenuation
from spectra.detector.multi_source import MultiSource
from spectra.errors import InputError

_STEP = 0.5  # keV; width of the bins that photons are drawn from


@dataclass(frozen=True, eq=False)
class ScanBeam:
    """Beam of a whole scan.

    Parameters
    ----------
    photons : that the scan sends to the panel, before what shapes the beam
    frames : of each view and module, source, vector to the first pixel's centre, column step and row step [mm]
    views : part of the photons of each view
    rows, columns : pixels of a module
    energy : of each bin [keV]
    spectrum : part of the photons of each bin
    lengths, shape : of what shapes the beam, as in `Beam`
    """

    photons: float
    frames: Float[np.ndarray, "view module 4 3"]
    views: Float[np.ndarray, " view"]
    rows: int
    columns: int
    energy: Float[np.ndarray, " bin"]
    spectrum: Float[np.ndarray, " bin"]
    lengths: Float[np.ndarray, "part row all_columns"]
    shape: Float[np.ndarray, "part bin"]

    @classmethod
    def of(cls, scan: Scan) -> "ScanBeam":
        """Describe the beam of a scan.

        Parameters
        ----------
        scan : the scan; views of all splits count

        Returns
        -------
        the beam

        Raises
        ------
        InputError
            When the scan has several sources, or its sample moves.
        """
        if isinstance(scan.detector, MultiSource):
            raise InputError(f"dose is computed for scans of one source, and {scan.name} has several")
        if scan.sample_poses is not None:
            raise InputError(f"dose is computed for samples that rest, and that of {scan.name} moves: leave motion out")
        panel, views = scan.geometry.panel, _factors(scan)
        edges = np.append(np.arange(1.0, scan.source.maximum, _STEP), scan.source.maximum + 1e-9)
        photons, energy = scan.source.photons_in(edges)
        used = photons > 0
        lengths, shape = np.zeros((0, panel.rows, panel.columns)), np.zeros((0, int(used.sum())))
        if scan.profile is not None:
            lengths, shape = scan.profile.lengths, scan.profile.attenuation(energy[used])
        return cls(
            float(photons.sum() * panel.rows * panel.columns * views.sum()),
            module_frames(scan.geometry),
            views / views.sum(),
            panel.rows,
            panel.columns // panel.modules,
            energy[used],
            photons[used] / photons.sum(),
            lengths,
            shape,
        )

    @property
    def drawn(self) -> Beam:
        """The beam as the kernel draws from it."""
        return Beam(
            self.frames,
            _cumulative(self.views),
            self.rows,
            self.columns,
            self.energy,
            _cumulative(self.spectrum),
            np.ascontiguousarray(self.lengths, dtype=np.float64),
            np.ascontiguousarray(self.shape, dtype=np.float64),
        )


def _cumulative(parts: Float[np.ndarray, " part"]) -> Float[np.ndarray, " part"]:
    """Cumulative sum that ends above every random number."""
    total = np.cumsum(parts)
    total[-1] = 2.0
    return total


def _factors(scan: Scan) -> Float[np.ndarray, " view"]:
    """Photons of each view over those of the source."""
    if scan.modulation is None:
        return np.ones(len(scan.geometry))
    if scan.modulation.factors is not None:
        return np.array(scan.modulation.factors)
    return scan.modulation.of(attenuation(scan, fine_transmission(scan)))
