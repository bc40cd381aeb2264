"""Air kerma of a scan with nothing in the beam."""

import numpy as np

from phantomgen.scene.scan import Scan
from spectra.detector.multi_source import MultiSource
from spectra.source.beam_quality import kerma_per_fluence


def kerma_per_view(scan: Scan, per_fluence: float | None = None) -> float:
    """Compute the air kerma of a view at the panel centre with nothing in the beam.

    Parameters
    ----------
    scan : the scan
    per_fluence : air kerma per photon and area of its source, where it is known [Gy mm^2]

    Returns
    -------
    air kerma [Gy]
    """
    panel = scan.geometry.panel
    per_photon = kerma_per_fluence(scan.source) if per_fluence is None else per_fluence
    return per_photon * scan.source.photons / (panel.row_pitch * panel.column_pitch)


def kerma_at_isocentre(scan: Scan, per_fluence: float | None = None) -> float:
    """Compute the air kerma of a scan at the isocentre with nothing in the beam, by the inverse square of distance.

    Test views count as well, and those of a helix as if they all met the isocentre. A current that follows the
    attenuation has the same sum as a constant one; sources that take turns share the views.

    Parameters
    ----------
    scan : the scan
    per_fluence : as in `kerma_per_view`

    Returns
    -------
    air kerma [Gy]
    """
    geometry, detector, modulation = scan.geometry, scan.detector, scan.modulation
    nearer = 1.0
    if not geometry.is_parallel:
        to_panel = np.linalg.norm(geometry.panel_center - geometry.source, axis=1)
        axes = slice(2) if geometry.kind == "helical" else slice(3)
        nearer = float(np.mean((to_panel / np.linalg.norm(geometry.source[:, axes], axis=1)) ** 2))
    turns = len(detector.sources) if isinstance(detector, MultiSource) and scan.exposure is not None else 1
    stated = None if modulation is None else modulation.factors
    views = len(geometry) if stated is None else sum(stated)
    return kerma_per_view(scan, per_fluence) * nearer * views / turns
