"""Expected counts of one view, of all its source points."""

import numpy as np
from jaxtyping import Float

from phantomgen.ops.expected_counts import Spectrum, expected_counts
from phantomgen.scene.scan import Scan
from phantomgen.simulation.forward_model.discretization import Settings
from phantomgen.simulation.forward_model.exposure import Groups
from spectra.transmission import Transmission


def expected_view(scan: Scan, transmission: Transmission, view: int, settings: Settings) -> Groups:
    """Compute the expected signals of one view and group of photons, averaged over pixel area and focal spot.

    Parameters
    ----------
    scan : what is simulated
    transmission : path lengths to signals
    view : number of the view
    settings : how finely it is computed

    Returns
    -------
    signals, (group, row, column)
    """
    modules = scan.geometry.panel.modules
    first = view * modules
    frames = scan.by_module.geometry[first : first + modules].ray_frames()
    middle = frames[modules // 2]  # the focal spot faces the middle of the panel
    images = [
        _expected_module(scan.by_module, transmission, first + module, frame, middle, settings)
        for module, frame in enumerate(frames)
    ]
    return images[0] if modules == 1 else np.concatenate(images, axis=-1)


def _expected_module(
    scan: Scan,
    transmission: Transmission,
    view: int,
    frame: Float[np.ndarray, "4 3"],
    middle: Float[np.ndarray, "4 3"],
    settings: Settings,
) -> Groups:
    """Expected signals of one module, averaged over the exposure where objects move or change in it."""
    if scan.dynamics is None:
        return _expected_instant(scan, transmission, view, frame, middle, settings)
    total = np.zeros(())
    for time, weight in zip(scan.dynamics.instants(view), scan.dynamics.weights, strict=True):
        still = scan.at_time(float(time))
        total = total + weight * _expected_instant(still, transmission, view, frame, middle, settings)
    return total


def _expected_instant(
    scan: Scan,
    transmission: Transmission,
    view: int,
    frame: Float[np.ndarray, "4 3"],
    middle: Float[np.ndarray, "4 3"],
    settings: Settings,
) -> Groups:
    """Expected signals of one module at one instant, whose focal spot lies along the steps of `middle`."""
    spot = scan.effects.focal_spot
    if spot is None:
        return exposed_frame(scan, transmission, view, frame, settings)
    points = settings.spot or spot.points_for(spot.blur(middle, scan.scene.solids.balls[:, :3]))
    frames = spot.frames(frame, points, middle[2:])
    total = exposed_frame(scan, transmission, view, frames[0], settings)
    for moved in frames[1:]:
        total += exposed_frame(scan, transmission, view, moved, settings)
    return total / len(frames)


def exposed_frame(
    scan: Scan, transmission: Transmission, view: int, frame: Float[np.ndarray, "4 3"], settings: Settings
) -> Groups:
    """Compute the expected signals of one view for rays of one source point.

    Parameters
    ----------
    scan : what is simulated, with a flat panel
    transmission : path lengths to signals
    view : number of the view
    frame : source, vector to pixel (0, 0), column step and row step [mm]
    settings : how finely it is computed

    Returns
    -------
    signals, (group, row, column)
    """
    panel, scene = scan.geometry.panel, scan.scene
    spectrum, sampling = spectrum_of(scan, transmission, view), settings.sampling(scan.aperture)
    return expected_counts(frame, panel.rows, panel.columns, scene.solids, spectrum, scene.background, sampling).counts


def spectrum_of(scan: Scan, transmission: Transmission, view: int = 0) -> Spectrum:
    """Return the energies of the beam as `phantomgen.ops.expected_counts` takes them.

    Parameters
    ----------
    scan : what is simulated, at one instant
    transmission : path lengths to signals
    view : number of the view

    Returns
    -------
    the energies, with the profile of the beam
    """
    columns, mixing = transmission.columns, scan.scene.mixing
    if mixing is not None:
        columns = np.concatenate([mixing @ columns[: len(mixing)], columns[len(mixing) :]])
    return Spectrum(columns, transmission.weights, transmission.starts, scan.view_profile(view))


def open_beam(scan: Scan, transmission: Transmission) -> Groups:
    """Compute the expected signals of one view without any object.

    Parameters
    ----------
    scan : what is simulated
    transmission : path lengths to signals

    Returns
    -------
    signals, (group, row, column)
    """
    pixels = (scan.geometry.panel.rows, scan.geometry.panel.columns)
    if scan.profile is None:
        return np.broadcast_to(transmission.open_beam[:, None, None], (len(transmission), *pixels))
    lengths = np.zeros((*pixels, len(transmission.columns)))
    lengths[:, :, -len(scan.profile.names) :] = np.moveaxis(scan.profile.lengths, 0, -1)
    return np.moveaxis(transmission.expected(lengths), -1, 0)
