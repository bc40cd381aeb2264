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
    views : part of the photons of each view
    mean_energy : of the photons [keV]
    drawn : the beam as the kernel draws from it
    """

    photons: float
    views: Float[np.ndarray, " view"]
    mean_energy: float
    drawn: Beam

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
        panel, factors = scan.geometry.panel, _factors(scan)
        edges = np.append(np.arange(1.0, scan.source.maximum, _STEP), scan.source.maximum + 1e-9)
        photons, energy = scan.source.photons_in(edges)
        used = photons > 0
        photons, energy = photons[used], energy[used]
        lengths, shape = np.zeros((0, panel.rows, panel.columns)), np.zeros((0, len(energy)))
        if scan.profile is not None:
            lengths, shape = scan.profile.lengths.astype(np.float64), scan.profile.attenuation(energy)
        views = factors / factors.sum()
        drawn = Beam(
            frames=module_frames(scan.geometry),
            views=_cumulative(views),
            rows=panel.rows,
            columns=panel.columns // panel.modules,
            energy=energy,
            spectrum=_cumulative(photons / photons.sum()),
            lengths=lengths,
            shape=shape,
        )
        total = float(photons.sum() * panel.rows * panel.columns * factors.sum())
        return cls(total, views, float(energy @ photons / photons.sum()), drawn)

    def at_height_zero(self, count: int) -> "ScanBeam":
        """Return the first views, each moved along z so that its source lies at z = 0.

        Parameters
        ----------
        count : number of views

        Returns
        -------
        their beam
        """
        part, frames = float(self.views[:count].sum()), self.drawn.frames[:count].copy()
        frames[:, :, 0, 2] = 0.0
        views = self.views[:count] / part
        return ScanBeam(
            self.photons * part, views, self.mean_energy, self.drawn._replace(frames=frames, views=_cumulative(views))
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
