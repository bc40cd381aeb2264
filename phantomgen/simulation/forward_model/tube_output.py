"""Output of the tube in each view: the modulation of its current, by a topogram of the scene, and its fluctuation."""

import numpy as np
from jaxtyping import Float

from phantomgen.effects.random_streams import Stream
from phantomgen.geometry.curved_panel import ray_directions
from phantomgen.scene.scan import Scan
from spectra.transmission import Transmission

ROWS, COLUMNS = 9, 64  # rays of a topogram, at most

Output = Float[np.ndarray, " frame"]


def tube_output(scan: Scan, transmission: Transmission) -> tuple[dict[Stream, Output], Output | None]:
    """Compute the output of the tube in all frames, relative to the exposure of the scan.

    Parameters
    ----------
    scan : what is simulated
    transmission : path lengths to signals

    Returns
    -------
    output in each view and in each flat, and what is known of that of the views; None where that is 1
    """
    frames = {Stream.PROJECTION: len(scan.geometry), Stream.FLAT: scan.flats}
    output = {stream: np.ones(count) for stream, count in frames.items()}
    known = None
    tube = scan.effects.tube_output
    if tube is not None:
        output = {stream: tube.factors(scan.seed, stream, count) for stream, count in frames.items()}
        known = output[Stream.PROJECTION] if tube.recorded else None
    if scan.modulation is not None:
        factors = scan.modulation.of(attenuation(scan, transmission))
        output[Stream.PROJECTION] = output[Stream.PROJECTION] * factors
        known = factors if known is None else known * factors
    return output, known


def attenuation(scan: Scan, transmission: Transmission) -> Float[np.ndarray, " view"]:
    """Compute the attenuation of each view, as a topogram shows it.

    Parameters
    ----------
    scan : what is simulated
    transmission : path lengths to signals

    Returns
    -------
    logarithm of open beam over signal, summed over channels, in the darkest column of each view; signals are means over
    its rows, by single rays through pixels
    """
    panel = scan.geometry.panel
    rows = np.unique(np.linspace(0, panel.rows - 1, ROWS).round())
    columns = np.unique(np.linspace(0, panel.columns - 1, COLUMNS).round())
    count, materials = len(transmission.columns), len(scan.scene.materials)
    found = np.empty(len(scan.geometry))
    for view in range(len(found)):
        one = scan.geometry[[view]]
        rays = ray_directions(one, columns, rows)[0].reshape(-1, 3)
        starts = np.broadcast_to(one.source, rays.shape)
        lengths = np.zeros((len(rays), count))  # those of a beam profile stay 0
        lengths[:, :materials] = scan.instant(view).scene.path_lengths(starts, rays)
        signal = transmission.expected(lengths).sum(axis=-1).reshape(len(rows), len(columns)).mean(axis=0)
        found[view] = np.log(transmission.open_beam.sum() / max(signal.min(), np.finfo(float).tiny))
    return found
